"""How often answers are wrong, in short: `make coverage` simulates them at length and writes docs/coverage.md."""

import sys
from pathlib import Path

import pytest

# At the end: nothing here may stand in for a module of another folder.
sys.path.append(str(Path(__file__).parent))
from rows import ROWS, Row, percent

QUICK = [row for row in ROWS if row.quick]


@pytest.mark.parametrize("row", QUICK, ids=lambda row: row.name)
def test_a_verdict_is_as_seldom_wrong_as_it_says(row: Row) -> None:
    share = percent(*row.events(row.quick))
    assert row.holds(share), f"{row.name}: {row.event} in {share:.1f} %"


@pytest.mark.parametrize("row", [row for row in QUICK if row.remedy], ids=lambda row: row.name)
def test_without_its_remedy_it_is_wrong(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    assert row.remedy is not None
    monkeypatch.setattr(*row.remedy)
    assert row.is_broken(row.quick), f"{row.name}: {row.event} as seldom as allowed without {row.remedy[1]}"
