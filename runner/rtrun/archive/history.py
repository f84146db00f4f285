"""The course of a scenario through an archive, as a table for people and as data for programs."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from rtfiles.output import console, print_line
from rtfiles.quantities import grouped, time
from rtrun.archive import By
from rtrun.archive.queries import Point
from rtrun.report.tables import Table
from rtrun.targets.inspection.platform import Platform


def print_course(points: Sequence[Point], *, by: By, deadline_ns: int | None) -> None:
    """Print the points of one scenario, a row each."""
    from rtrun.report.terminal import print_banner

    print_line(points[0].scenario)
    print_banner(Platform(points[0].platform))
    # The column that --by names comes first, and is not repeated among the others.
    leading = {"kernel": ("kernel", "board"), "board": ("board", "kernel")}.get(by, (by, "board", "kernel"))
    columns = (*leading, "runs", "boots", "n", *points[0].times_ns)
    columns += (f"P(> {time(deadline_ns)})",) if deadline_ns else ()
    rows = []
    for point in points:
        names: dict[str, str] = {by: point.label, "board": point.machine, "kernel": point.kernel or "unknown"}
        rows.append(
            (
                *(names[heading] for heading in leading),
                f"{len(point.run_keys)}{f', {point.off_rate} off rate' if point.off_rate else ''}",
                str(point.boots),
                grouped(point.n),
                *map(time, point.times_ns.values()),
                *([misses_text(point)] if deadline_ns else []),
            )
        )
    console().print(Table(columns=columns, rows=rows, numbers=range(len(leading), len(columns))))


def misses_text(point: Point) -> str:
    """The share of misses of a point, for a table."""
    if point.p_miss is None:
        return "not known"
    return f"{point.misses} of {grouped(point.n)}" if not point.misses else f"{point.p_miss:.2g} ({point.misses})"


def as_data(points: Sequence[Point], *, by: By, deadline_ns: int | None) -> dict[str, Any]:
    """The points as plain data: times in ns, percentiles by their number."""
    names = [field.name for field in fields(Point)]
    return {
        "schema": 1,
        "by": by,
        "deadline_ns": deadline_ns,
        "points": [
            {name: getattr(point, name) for name in names}
            | {
                "start_utc": point.start_utc.isoformat() + "Z" if point.start_utc else None,
                "percentiles_ns": {f"p{p:g}": value for p, value in point.percentiles_ns.items()},
                "p_miss": point.p_miss,
            }
            for point in points
        ],
    }
