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


def oneshot_rows() -> list[dict[str, Any]]:
    """Rows of the published one-shot table, columns by name; times in us, and whether the kernel was PREEMPT_RT."""
    table = published()["oneshot_table"]
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
    return [row | {"timeout_us": 1000 * row["timeout_ms"], "preempt_rt": "-rt" in row["kernel"]} for row in rows]
