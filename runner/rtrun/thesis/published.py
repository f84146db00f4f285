"""The figures of 2014 beside those of a campaign."""

from rtfiles.quantities import time
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.report.tables import Table
from rtrun.thesis.reference import message_rows, oneshot_rows


def published_figures(study: Study) -> Table:
    """What was measured as in 2014, beside the figures of its published row; no row where nothing was."""
    of_table, others = oneshot_rows(), message_rows()
    matched = [(row, group) for group in study.as_in_2014 for row in (*of_table, *others) if row.is_like(group)]
    measured = sum(any(map(row.is_like, study.as_in_2014)) for row in of_table)
    columns_here, columns_there = ("min", "mean", "max"), ("2014 min", "2014 mean", "2014 max")
    return Table(
        id="published",
        title="Beside the published PandaBoard figures",
        columns=("suite and parameters", "published", *columns_here, *columns_there),
        rows=[
            (group.label, row.place, *_here(group), *(time(1000 * figure) for figure in row.figures_us))
            for row, group in matched
        ],
        outcome=f"{measured} of the {len(of_table)} rows of the one-shot table were measured here",
        numbers=2,
        notes=("Another board, kernel or ROS: a difference says nothing about any one of them alone.",),
    )


def _here(group: Group) -> tuple[str, str, str]:
    lows = [d.figures.min_ns for d in group.digests if d.figures.min_ns is not None]
    highs = [d.figures.max_ns for d in group.digests if d.figures.max_ns is not None]
    means = [(d.figures.mean_ns * d.n, d.n) for d in group.digests if d.figures.mean_ns is not None]
    mean = sum(total for total, _ in means) / sum(n for _, n in means) if means else None
    return time(min(lows, default=None)), time(mean), time(max(highs, default=None))
