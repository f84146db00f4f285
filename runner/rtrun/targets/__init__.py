"""Where a campaign is measured: the target, the link to it, and what is done there before and after a run."""
