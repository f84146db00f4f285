"""Where it is measured: the target, the link to it, and what is done on it before and after a run."""
