"""Readers of other programs' measurements, and the file that keeps a histogram and what its format left out."""
