"""Readers of what other programs measured, and the file that keeps a histogram with what it lacks."""
