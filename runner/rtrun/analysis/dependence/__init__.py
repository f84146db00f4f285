"""Dependence: what measurements are worth that are not independent, and the units that they come in."""
