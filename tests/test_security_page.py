"""Each limit in docs/security.md equals the constant that it names."""

import importlib
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs/security.md"
UNITS = {"": 1, "KiB": 2**10, "MiB": 2**20, "s": 1, "bytes/s": 1, "characters": 1}
ROWS = re.findall(r"^\| [^|]+ \| ([0-9]+) ?([A-Za-z/]*) \| `([\w.]+)\.(\w+)` \|$", PAGE.read_text(), re.M)


@pytest.mark.parametrize(("number", "unit", "module", "name"), ROWS, ids=[row[3] for row in ROWS])
def test_limit(number: str, unit: str, module: str, name: str) -> None:
    assert getattr(importlib.import_module(module), name) == int(number) * UNITS[unit]


def test_every_row_of_the_table_is_read() -> None:
    assert len(ROWS) == PAGE.read_text().count("\n| ") - 1 > 30
