"""Chances: distributions, intervals of a probability, tests of ranks and means, and how many measurements decide."""
