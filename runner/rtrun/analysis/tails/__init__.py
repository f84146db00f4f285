"""Tails: the worst case, from the highest values."""
