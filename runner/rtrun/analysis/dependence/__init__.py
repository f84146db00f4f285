"""Dependence: what dependent measurements are worth, and the units that they come in."""
