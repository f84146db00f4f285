"""Runs of many months and boards, kept as Parquet files (docs/archive.md)."""

from typing import Literal

By = Literal["day", "month", "kernel", "board", "commit", "image", "run"]
"""What distinguishes the points of a course, besides board and kernel, which are never pooled."""
