"""Where a campaign is measured: the target, the link to it, and the work on it before and after a run."""
