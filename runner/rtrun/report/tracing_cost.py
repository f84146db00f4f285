"""What tracing costs: traced runs compared with their untraced twins, measured alternately."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby

from rtfiles.errors import UsageError
from rtfiles.output import counted, printable
from rtfiles.quantities import signed, time
from rtrun.analysis.comparison.differences import ComparisonAnswer
from rtrun.causes.measured import traced_series
from rtrun.judgement.compare import Changed, compare_studies
from rtrun.judgement.sides import names_of_sides, split
from rtrun.judgement.study import Study, study
from rtrun.kinds.lateness import Measure
from rtrun.plan.question import Question
from rtrun.plan.run import UNTRACED
from rtrun.plan.suites import measures
from rtrun.plan.trace import PARAMETER, quantile
from rtrun.report.tables import Table
from rtrun.results.reading import Source
from rtrun.results.record import RunRecord, RunStatus, read_record


def thresholds(records: Sequence[RunRecord], measure: Measure | None) -> Iterator[str]:
    """Which traces belong to another series than `measure` (None: any series), and the limits that warm-ups found.

    One sentence for each other series, and one for each quantile that a campaign asks for.
    """
    kept = [run for run in records if run.parameters.get(PARAMETER) is not None and measure in measures(run.suite)]
    series = Counter(traced_series(run.suite, run.parameters) for run in kept)
    for traced, number in series.items():
        if traced != measure:
            where = counted(number, "run")
            yield f"Traces are of the {traced} in {where}, not of the {measure}, which takes trace_of: {measure}"
    measured = [run for run in records if quantile(run.trace) is not None and run.status is RunStatus.OK]
    for trace, alike in groupby(sorted(measured, key=lambda run: (run.trace, run.suite)), key=lambda run: run.trace):
        limits_us = sorted(int(run.parameters.get(PARAMETER) or 0) for run in alike)
        lowest, highest = limits_us[0], limits_us[-1]
        between = " to ".join(dict.fromkeys(time(1000 * limit_us) for limit_us in (lowest, highest)))
        runs = "a run" if len(limits_us) == 1 else f"{len(limits_us)} runs"
        yield f"Traced is what is above {trace} of the values before: {between} in {runs}"


def tracing_cost_at(source: Source, measure: Measure | None) -> tuple[Table | None, tuple[str, ...]]:
    """The comparison for the runs at a path, None where no run has a twin; and why they cannot be compared."""
    try:
        if all(read_record(folder).trace != UNTRACED for folder in source.folders):
            return None, ()
        return tracing_cost(study(source.path, Question(of=measure), bounds=False)), ()
    except UsageError as error:
        return None, tuple(str(error).splitlines())


def tracing_cost(examined: Study) -> Table:
    """Quantiles with and without traces, and the difference with its interval; without rows where no run has a twin."""
    changes = list(_changes(examined))
    rows = [row for change in changes for row in _rows(change)]
    confidence = f"{100 * examined.question.confidence:g} %"
    return Table(
        id="tracing",
        title="What tracing costs",
        columns=("suite and parameters", "figure", "untraced", "traced", f"difference, {confidence} interval"),
        rows=rows,
        outcome=_outcome([change.comparison.answer for change in changes]),
        numbers=range(2, 5),
        notes=tuple(
            dict.fromkeys(printable(f"assumes {text}") for change in changes for text in change.comparison.assumes)
        ),
    )


def _outcome(answers: Sequence[ComparisonAnswer]) -> str:
    if shifted := answers.count(ComparisonAnswer.DIFFERENT):
        return f"tracing shifts values in {shifted} of {len(answers)} scenarios"
    if differ := answers.count(ComparisonAnswer.RUNS_DIFFER):
        return (
            f"these traced runs differ from the untraced in {differ} of {len(answers)} scenarios; "
            "whether tracing shifts values takes five pairs of runs measured in turn (repeats: 5)"
        )
    return "no shift by tracing is seen: an interval says how large it may be"


def _changes(examined: Study) -> Iterator[Changed]:
    known = names_of_sides(examined, "trace")
    if UNTRACED not in known:
        return
    for limit in known:
        if limit != UNTRACED:
            _, (untraced, traced) = split(examined, "trace", (UNTRACED, limit))
            yield from compare_studies(untraced, traced, margin_ns=None).changes


def _rows(change: Changed) -> Iterator[tuple[str, ...]]:
    compared = change.comparison
    if not compared.shifts:
        yield change.label, "-", "-", "-", f"{min(compared.unit_counts)} {compared.units} are too few to compare"
    for shift in compared.shifts:
        difference = f"{signed(shift.shift_ns)} ({signed(shift.low_ns)} to {signed(shift.high_ns)})"
        yield change.label, shift.figure, time(shift.a_ns), time(shift.b_ns), difference
