"""The queries that docs/archive.md shows for other programs, on an archive of several days."""

import re
from pathlib import Path

from report.campaigns import NOT_FIRED, latencies, oneshot_rows, write_run

PAGE = Path(__file__).parents[3] / "docs" / "archive.md"


def write_days(root: Path, days: int) -> Path:
    """A run of one-shot timers a day, each a little slower; the fifth timer of each never fires."""
    for day in range(days):
        values = latencies(500, day, 90.0 + day)
        values[4] = NOT_FIRED
        write_run(
            root,
            f"{day:03d}-oneshot",
            "oneshot_timer_tests",
            [oneshot_rows(values, 1000)],
            {"policy": "RR", "timeout_us": 1000, "busy_mode": 0},
            asked=500,
            logs=False,
            start_time=f"2026-{10 + day // 2:02d}-0{1 + day % 2}T10:00:00+02:00",
            target={"name": f"board-{day % 2}", "kernel_release": f"6.{day // 2}", "boot_id": f"boot-{day}"},
        )
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
