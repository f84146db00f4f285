"""The figures of 2014 beside those of a campaign."""

from rtfiles.quantities import time
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.study import Study
from rtrun.report.quantities import times_ns
from rtrun.report.tables import Table
from rtrun.thesis.reference import message_rows, oneshot_rows

_SHOWN = ("min", "mean", "max")


def published_figures(study: Study) -> Table:
    """Measurements like those of 2014, next to the published figures; no row without measurements."""
    of_table, others = oneshot_rows(), message_rows()
    matched = [(row, group) for group in study.as_in_2014 for row in (*of_table, *others) if row.is_like(group)]
    measured = sum(any(map(row.is_like, study.as_in_2014)) for row in of_table)
    here = [times_ns(pool_figures(group.digests)) for _, group in matched]
    return Table(
        id="published",
        title="Beside the published PandaBoard figures",
        columns=("suite and parameters", "published", *_SHOWN, *(f"2014 {name}" for name in _SHOWN)),
        rows=[
            (group.label, row.place, *map(time, [*map(times.get, _SHOWN), *(1000 * us for us in row.figures_us)]))
            for (row, group), times in zip(matched, here, strict=True)
        ],
        outcome=f"{measured} of the {len(of_table)} rows of the one-shot table were measured here",
        numbers=range(2, 8),
        notes=("Another board, kernel or ROS: a difference says nothing about any one of them alone.",),
    )
