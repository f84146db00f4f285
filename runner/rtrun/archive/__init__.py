"""Runs of many months and boards, kept as Parquet files (docs/archive.md)."""

from typing import Literal

NO_DEADLINE = "misses are not counted without a deadline: ask with --deadline TIME, as --deadline 1ms"
"""For queries that name none: quantiles are shown, and P(miss) is not."""
By = Literal["day", "month", "kernel", "board", "commit", "image", "run"]
"""What distinguishes the points of a course, besides board and kernel, which are never pooled."""
