"""Chances: distributions, intervals of a probability, tests of ranks and means, how many measurements decide."""
