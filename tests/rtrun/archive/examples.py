"""The queries that docs/archive.md shows for other programs, on an archive of several days."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from report.campaigns import NOT_FIRED, cyclic_run, latencies, oneshot_run

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


def write_mixture(root: Path) -> Path:
    """Several days; on the first one two kernels on one board, two builds of one of them, and a cyclic timer twice."""
    write_days(root, 4)
    for k, (release, build) in enumerate((("6.0", "#2"), ("6.6", "#1"))):
        target = {"name": "board-0", "kernel_release": release, "kernel_version": build, "boot_id": f"boot-{build}"}
        start = f"2026-10-01T1{k + 2}:00:00+02:00"
        oneshot_run(root, f"10{k}-oneshot", latencies(400, 10 + k, 120.0), start_time=start, target=target)
        late = latencies(300, 20 + k)
        late[50:60] += 1_000_000
        cyclic_run(root, f"11{k}-cyclic", late, hz=1000, start_time=start, target=target)
    return root


def expected_answer(points: Sequence[Mapping[str, Any]]) -> list[tuple[object, ...]]:
    """What the examples give where `rtrun history`, by day, gives these points."""
    return sorted(
        (
            point["scenario"].removesuffix(", jitter"),
            *(point[name] for name in ("machine", "kernel", "series", "label", "n")),
            point["percentiles_ns"]["p99"],
            point["misses"],
        )
        for point in points
    )


def answer_of(program: str, archive: Path) -> list[tuple[object, ...]]:
    """The rows of the page's example for a program."""
    (code,) = [
        code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if f"import {program}" in code
    ]
    names: dict[str, object] = {"ARCHIVE": archive}
    exec(code, names)
    answer = names["answer"]
    assert isinstance(answer, list)
    return sorted(tuple(row) for row in answer)
