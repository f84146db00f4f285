"""The published results of 2014 (pandaboard-2014.yml), to compare with."""

import functools
from pathlib import Path
from typing import Any

from rtfiles.config import read_yaml

FILE = Path(__file__).with_name("pandaboard-2014.yml")


@functools.cache
def published() -> dict[str, Any]:
    """The whole file as plain data."""
    data: dict[str, Any] = read_yaml(FILE)
    return data


def oneshot_rows(policy: str, timeout_us: int) -> list[dict[str, Any]]:
    """Rows of the published one-shot table for this policy and timeout, columns by name; times in us."""
    table = published()["oneshot_table"]
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
    return [row for row in rows if row["policy"] == policy and row["timeout_ms"] * 1000 == timeout_us]
