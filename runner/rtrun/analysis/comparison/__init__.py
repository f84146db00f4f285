"""Comparison: do two sets of runs differ, and by how much?"""
