"""The queries that docs/archive.md shows for other programs, on an archive of several days."""

import re
from pathlib import Path

from report.campaigns import NOT_FIRED, latencies, oneshot_run

PAGE = Path(__file__).parents[3] / "docs" / "archive.md"


def write_days(root: Path, days: int) -> Path:
    """A run of one-shot timers a day, each a little slower; the fifth timer of each never fires."""
    for day in range(days):
        values = latencies(500, day, 90.0 + day)
        values[4] = NOT_FIRED
        target = {"name": f"board-{day % 2}", "kernel_release": f"6.{day // 2}", "boot_id": f"boot-{day}"}
        start = f"2026-{10 + day // 2:02d}-0{1 + day % 2}T10:00:00+02:00"
        oneshot_run(root, f"{day:03d}-oneshot", values, start_time=start, target=target)
    return root


def answer_of(program: str, archive: Path) -> list[tuple[object, ...]]:
    """The rows of the page's example for a program."""
    (code,) = [
        code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if f"import {program}" in code
    ]
    names: dict[str, object] = {"ARCHIVE": archive}
    exec(code, names)
    answer = names["answer"]
    assert isinstance(answer, list)
    return [tuple(row) for row in answer]
