"""How the causes of outliers are reported, on the terminal and in a report."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rtfiles.errors import UsageError
from rtfiles.output import counted, printable, showing_progress
from rtfiles.quantities import time
from rtrun.causes.outliers import Explained, explain_run
from rtrun.causes.parts import NAMELESS, Cause, Kind
from rtrun.causes.ranking import Culprit, Ranking, rank
from rtrun.causes.reconstruction import NORMAL_PRIO
from rtrun.causes.recurring import Recurring, recurring
from rtrun.causes.remedies import remedy
from rtrun.causes.steps import Step
from rtrun.causes.surroundings import find_unusual
from rtrun.causes.waits import EVENTS_MISSING
from rtrun.kinds.lateness import Measure
from rtrun.report.tables import Table
from rtrun.results.reading import Source
from rtrun.results.record import RunRecord, RunStatus, read_record
from rtrun.targets.inspection.kernel_trace import OPTIONS

T = TypeVar("T")

Found = tuple[Ranking, tuple[Explained, ...], tuple[str, ...]]
"""The ranking of culprits, the outliers it is based on, and the reason for each run with unreadable traces."""

REMEDIES_MAX = 3  # shown
NAMES_MAX = 5  # shown
_RAISE = (
    "Most outliers have no trace: raise the limit of the campaign (trace: {above: ...}), so that fewer values ask for "
    "one while another is copied"
)
# Why a cause is not known, and what would help, by the words of what is unexplained.
_UNKNOWN = {
    EVENTS_MISSING: (
        "the trace lost events there",
        "Trace fewer of them: raise the limit (trace: {above: ...}), or measure fewer programs at once",
    ),
}
_UNKNOWN_OUTSIDE = (
    "the thread had nothing to do until {name} woke it, and the trace does not show why that came late",
    "Look at what sends it: the device, or the other machine",
)
_UNKNOWN_OTHERWISE = (
    "no event of the trace explains the wait",
    "`rtrun why --all` lists the parts of each",
)
# Idle CPUs and callbacks are listed with an outlier if they took at least this share of its value.
BESIDE_FROM = 0.1
# Culprits with less than this share of all lateness are counted, not listed.
LISTED_FROM = 0.01
# A remedy is given for a culprit with at least this share of all lateness.
REMEDY_FROM = 0.1


# Their values do not count.
_FAILED = (RunStatus.FAILED, RunStatus.INVALID)


def periods(source: Source, measure: Measure | None) -> tuple[Table, tuple[str, ...]]:
    """The periods of late values, a row for each output that has one, and why a run could not be searched.

    `measure` is the series of the values; None: the series of each run's traces.
    """
    found, refused = _search(source, partial(recurring, measure=measure), without=_FAILED)
    rows = [
        (
            finding.run,
            finding.output,
            str(finding.recurrence.late),
            _distance(finding),
            f"{finding.recurrence.covered} of {finding.recurrence.cycles}",
            _chance(finding.recurrence.p_value),
        )
        for finding in found
    ]
    named = Counter(_distance(finding) for finding in found).most_common(1)
    return Table(
        id="periods",
        title="Late values that come at a period",
        columns=("run", "output", "highest values", "come every", "periods that have one", "p"),
        rows=rows,
        outcome=f"every {named[0][0]}, in {counted(named[0][1], 'output')}" if named else "",
        numbers=range(2, 6),
        how="periods",
    ), refused


def _search(
    source: Source, find: Callable[[Path, RunRecord], Iterable[T]], *, without: Sequence[RunStatus] = ()
) -> tuple[list[T], tuple[str, ...]]:
    """What is found in the runs, `without` those of these statuses, and why a run could not be searched."""
    found: list[T] = []
    refused: list[str] = []
    for folder in showing_progress(source.folders, "searching run"):
        try:
            record = read_record(folder)
            if record.status not in without:
                found += find(folder, record)
        except UsageError as error:
            refused.append(str(error))
    return found, tuple(refused)


def _chance(p_value: float) -> str:
    return f"{p_value:.1g}" if p_value > 1e-99 else "below 1e-99"


def _distance(finding: Recurring) -> str:
    period = finding.recurrence.period
    return f"{period:.3g} loops" if finding.in_loops else f"{period / 1e9:.3g} s"


def surroundings(source: Source, measure: Measure | None) -> tuple[Table, tuple[str, ...]]:
    """What the sampler saw as unusual around the highest values, and why a run could not be searched.

    `measure` is the same as for `periods`.
    """
    found, refused = _search(source, partial(find_unusual, measure=measure), without=_FAILED)
    named = Counter(finding.quantity for finding in found).most_common(1)
    return Table(
        id="surroundings",
        title="What else was unusual when the highest values came",
        columns=("run", "output", "quantity", "unit", "when highest", "otherwise", "p"),
        rows=[
            (
                finding.run,
                finding.output,
                finding.quantity,
                finding.unit,
                f"{finding.late:.4g}",
                f"{finding.otherwise:.4g}",
                f"{finding.p_value:.1g}",
            )
            for finding in found
        ],
        outcome=f"{named[0][0]}, in {counted(named[0][1], 'output')}" if named else "",
        numbers=range(4, 7),
        notes=(
            "Medians of the tenth of all observations with the highest values, and of the others. What coincides need "
            "not be the cause.",
        ),
        how="surroundings",
    ), refused


def no_traces(source: Source) -> str:
    """Why there is no trace of an outlier, in one sentence."""
    records = [read_record(folder) for folder in source.folders]
    if any(record.parameters.get(option) is not None for record in records for option in OPTIONS):
        return "No value was above the limit from which on a run keeps traces"
    return "No run kept kernel traces, which name causes: a campaign asks for them by trace: {above: p99.9}"


def answer(ranking: Ranking) -> str:
    """The culprit of most outliers, in one sentence."""
    if not ranking.outliers:
        return "No outlier has a trace that could be read"
    outliers = counted(ranking.outliers, "traced outlier")
    first = ranking.culprits[0]
    is_half = 2 * first.main >= max(1, ranking.outliers)
    if (named := ranking.named or (first if is_half else None)) is not None:
        if named.kind in (Kind.UNEXPLAINED, Kind.OUTSIDE):
            return _not_known(ranking, named)
        perhaps = "Perhaps: " if ranking.is_by_chance(named) else ""
        chance = ", which may be by chance" if perhaps else ""
        return (
            f"{perhaps}{culprit_name(named)}: the main cause of {named.main} of {outliers}, "
            f"{_percent(named.total_ns, ranking.late_ns)} of their lateness{chance}"
        )
    if (kind := ranking.named_kind) is not None:
        names = [culprit.name for culprit in ranking.culprits if culprit.kind is kind]
        total_ns = sum(culprit.total_ns for culprit in ranking.culprits if culprit.kind is kind)
        more = f" and {len(names) - NAMES_MAX} more" if len(names) > NAMES_MAX else ""
        return printable(
            f"{kind}, none of them alone: the main cause of {ranking.main_by_kind[kind]} of {outliers}, "
            f"{_percent(total_ns, ranking.late_ns)} of their lateness: {', '.join(names[:NAMES_MAX])}{more}"
        )
    if not first.main:
        return f"No cause stands out in {outliers}"
    return (
        f"No cause stands out: the most frequent, {culprit_name(first)}, is the main one of {first.main} of {outliers}"
    )


def _not_known(ranking: Ranking, first: Culprit) -> str:
    """The answer where no event explains most of the waiting time: what is known, what is not, and what would help."""
    rest = next((culprit for culprit in ranking.culprits if culprit.kind not in NAMELESS), None)
    known = f"{culprit_name(rest)}: {_percent(rest.total_ns, ranking.late_ns)} of all lateness; " if rest else ""
    why, help_ = _UNKNOWN_OUTSIDE if first.kind is Kind.OUTSIDE else _UNKNOWN.get(first.name, _UNKNOWN_OTHERWISE)
    outliers = counted(ranking.outliers, "traced outlier")
    unknown = f"cause not known for {first.main} of {outliers}: {why.format(name=printable(first.name))}"
    text = f"{known}{unknown}. {help_}"
    return text[0].upper() + text[1:]


def culprit_name(culprit: Culprit) -> str:
    """What took the time and, where it is a thread, its id and priority."""
    if culprit.threads + culprit.alike > 1:
        return printable(f"{culprit.kind} {_who(culprit)}")
    return printable(_cause(culprit))


def _who(culprit: Culprit) -> str:
    """The name, and how many threads have it: a program that is restarted again and again gets a new id each time."""
    if culprit.alike:
        return f"{culprit.name} ({culprit.threads + culprit.alike} threads of such names)"
    return culprit.name if culprit.threads < 2 else f"{culprit.name} ({culprit.threads} threads of this name)"


def remedies(ranking: Ranking) -> Iterator[str]:
    """What to change about the first culprits, one sentence each, with its source."""
    grave = [culprit for culprit in ranking.culprits if culprit.extra_ns >= REMEDY_FROM * ranking.late_ns]
    names: dict[str, list[str]] = defaultdict(list)
    for culprit in grave:
        found = remedy(culprit.kind, culprit.name)
        if found is not None:
            names[f"{found.advice} ({found.source})"].append(culprit.name or culprit.kind)
    for advice in list(names)[:REMEDIES_MAX]:
        yield printable(f"{', '.join(names[advice])}: {advice}")


def table(ranking: Ranking, explained: Sequence[Explained]) -> Table:
    """The ranking of culprits; without rows where there are no traces."""
    listed = [
        culprit
        for culprit in ranking.culprits
        if culprit.main or culprit.kind is Kind.UNEXPLAINED or culprit.total_ns >= LISTED_FROM * ranking.late_ns
    ]
    others = len(ranking.culprits) - len(listed)
    nothing = (Kind.UNEXPLAINED.value, "", "", f"0 of {ranking.outliers}", "0", time(0), time(0), "-")
    is_all_explained = ranking.outliers and all(culprit.kind is not Kind.UNEXPLAINED for culprit in listed)
    return Table(
        id="causes",
        title="What late values waited for",
        columns=("what", "who", "priority", "outliers", "main cause", "total", "worst", "as long when in time"),
        rows=[
            (
                culprit.kind.value,
                _who(culprit),
                _priority(culprit),
                f"{culprit.count} of {ranking.outliers}",
                str(culprit.main),
                time(culprit.total_ns),
                time(culprit.worst_ns),
                f"{culprit.as_long} of {culprit.windows}" if culprit.windows else "-",
            )
            for culprit in listed
        ]
        + [nothing] * bool(is_all_explained),
        outcome=answer(ranking),
        numbers=range(3, 8),
        notes=(
            *remedies(ranking),
            *(printable(limit) for limit in dict.fromkeys(limit for case in explained for limit in case.limits)),
            *without_trace(explained),
            *([f"{others} more took less than 1 % each"] if others else []),
        ),
    )


def as_data(ranking: Ranking, explained: Sequence[Explained]) -> dict[str, Any]:
    """The ranking and every outlier for programs; times in nanoseconds."""
    return {
        "late_ns": ranking.late_ns,
        "culprits": [asdict(culprit) for culprit in ranking.culprits],
        "remedies": list(remedies(ranking)),
        "outliers": [
            {
                **asdict(case.outlier),
                "parts": [{**asdict(part.cause), "cpu": part.cpu, "length_ns": part.length_ns} for part in case.parts],
                "steps": dict(case.steps),
                "note": case.note,
            }
            for case in explained
        ],
    }


def step_table(explained: Sequence[Explained]) -> Table:
    """The steps of late messages over all outliers; without rows where no message was traced."""
    chains = [case.steps for case in explained if case.steps]
    whole_ns = sum(sum(chain.values()) for chain in chains)
    lengths = {step: [chain[step] for chain in chains if step in chain] for step in Step}
    longest = max(Step, key=lambda step: sum(lengths[step]))
    return Table(
        id="steps",
        title="Where late messages were",
        columns=("step", "outliers", "total", "worst", "of all"),
        rows=[
            (
                step.value,
                f"{len(of_step)} of {len(chains)}",
                time(sum(of_step)),
                time(max(of_step)),
                _percent(sum(of_step), whole_ns),
            )
            for step, of_step in lengths.items()
            if of_step
        ],
        numbers=range(1, 5),
        outcome=f"longest in step '{longest}', {_percent(sum(lengths[longest]), whole_ns)} of their latency",
    )


def without_trace(explained: Iterable[Explained]) -> list[str]:
    """How many outliers have no parts, and why."""
    every = list(explained)
    notes = [case.note for case in every if not case.parts]
    texts = [f"{counted(notes.count(note), 'outlier')} without parts: {note}" for note in dict.fromkeys(notes)]
    if 2 * len(notes) > len(every) > 1:
        texts.append(_RAISE)
    return texts


def lines(case: Explained, *, every: bool = True) -> Iterator[str]:
    """An outlier and the parts of its time, longest first, a line each; the parts add up to the value.

    Unless `every` part is wanted, the parts below `LISTED_FROM` of the value share one line.
    """
    outlier = case.outlier
    at = f"{outlier.at_ns // 10**9}.{outlier.at_ns % 10**9 // 1000:06} s"
    note = f"; {case.note}" if case.note else ""
    where = f"{outlier.run} {outlier.output}, index {outlier.index}, at {at}"
    yield printable(f"{time(outlier.value_ns)} too late: {where}{note}")
    if case.steps:
        yield "  " + " > ".join(f"{step} {time(length_ns)}" for step, length_ns in case.steps.items())
    lengths: Counter[tuple[Cause, int | None]] = Counter()
    for part in case.parts:
        lengths[part.cause, part.cpu] += part.length_ns
    least_ns = 0 if every else LISTED_FROM * outlier.value_ns
    short_ns = [ns for (cause, _), ns in lengths.items() if ns < least_ns and cause.kind is not Kind.UNEXPLAINED]
    for (cause, cpu), length_ns in lengths.most_common():
        if length_ns < least_ns and cause.kind is not Kind.UNEXPLAINED and len(short_ns) > 1:
            continue
        yield printable(f"  {time(length_ns):>13}  {_cause(cause)}{'' if cpu is None else f', CPU {cpu}'}")
    if len(short_ns) > 1:
        yield f"  {time(sum(short_ns)):>13}  {len(short_ns)} more, which took less than 1 % each"
    if all(cause.kind is not Kind.UNEXPLAINED for cause, _ in lengths):
        yield f"  {time(0):>13}  {Kind.UNEXPLAINED}"
    for callback in case.callbacks:
        if callback.took_ns is not None and callback.took_ns < BESIDE_FROM * outlier.value_ns:
            continue
        begun = f"began {time(outlier.at_ns - callback.begin_ns)} before the value"
        took = f"took {time(callback.took_ns)}" if callback.took_ns is not None else "when it ended is not known"
        yield printable(f"  its thread was in a callback: {callback.name}, which {begun}, {took}")
    for cpu, idle_ns in case.idle_ns.items():
        if idle_ns >= BESIDE_FROM * outlier.value_ns:
            why = "its affinity excludes it, or it was not moved there"
            yield f"  meanwhile CPU {cpu} was idle for {time(idle_ns)}: {why}"


def _cause(cause: Cause | Culprit) -> str:
    """What took the time and, in brackets, the id and priority of a thread."""
    of_thread = "" if cause.pid is None else f"({', '.join(filter(None, [f'pid {cause.pid}', _priority(cause)]))})"
    return " ".join(filter(None, [cause.kind.value, cause.name, of_thread]))


def _priority(cause: Cause | Culprit) -> str:
    """The priority of a thread and, where it is higher, that of the waiting thread."""
    above = "" if cause.above is None else f" above {_policy(cause.above)}"
    return "" if cause.prio is None else f"{_policy(cause.prio)}{above}"


def _policy(prio: int) -> str:
    """The kernel's `prio` in the words of sched(7)."""
    if prio < 0:
        return "deadline"
    return f"real-time {99 - prio}" if prio < NORMAL_PRIO else f"nice {prio - 120}"


def _percent(part_ns: int, whole_ns: int) -> str:
    return f"{100 * part_ns / whole_ns:.0f} %" if whole_ns else "0 %"


def ranked(source: Source) -> Found:
    """The ranking at a path, the outliers it is based on, and what was refused."""
    explained, refused = _search(source, explain_run)
    return rank(explained), tuple(explained), refused
