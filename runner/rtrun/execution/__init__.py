"""Measure a campaign run by run on a target, through lost links, restarts and killed runners."""
