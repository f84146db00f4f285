"""The scenarios of a report: for each group of equal runs its verdict in words and its tables."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rtfiles.output import printable
from rtfiles.quantities import grouped, percent, time
from rtrun.analysis.figures import Figures
from rtrun.judgement.digest import Digest, pool_figures
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import severity, verdict_line
from rtrun.kinds.known import CLUSTERED
from rtrun.plan.conditions import IDLE
from rtrun.plan.suites import in_words
from rtrun.report.quantities import LOST, times_ns
from rtrun.report.tables import Table, printable_table
from rtrun.results.series import MEASURED_2014, NOTE_2014

MUCH_MISSING = 0.01
_SHOWN = ("max", "p99.999", "p99.99", "p99.9", "p99", "p90", "p50", "min", "mean", "std")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A group of equal runs as the report shows it; `id` is unique in the report and holds only ``a-z0-9-``."""

    id: str
    label: str
    answer: str
    text: str
    group: Group
    figures: Figures
    tables: tuple[Table, ...]

    @property
    def suite(self) -> str:
        """The suite's name without its ending."""
        return self.group.suite.removesuffix("_tests")

    @property
    def policy(self) -> str:
        """The requested scheduling policy, as the kernel calls it."""
        policy = printable(str(self.group.parameters.get("policy", "0")))
        return "OTHER" if policy == "0" else policy

    @property
    def measured(self) -> str:
        """What its values measure, in words."""
        return in_words(printable(self.group.suite), self.group.series)

    @property
    def missing_share(self) -> float:
        """The share of its values that never came, or were skipped."""
        if (verdict := self.group.verdict) is not None:
            return verdict.absent / verdict.n if verdict.n else 0.0
        missing = sum(digest.header.missing for digest in self.group.digests)
        return missing / (self.group.n + missing) if missing else 0.0

    @property
    def missing(self) -> str:
        """That share in words, where so much is missing that its highest value says little; else empty."""
        return f"{percent(self.missing_share)} missing" if self.missing_share >= MUCH_MISSING else ""

    @property
    def condition(self) -> str:
        """What ran next to the suite."""
        return printable(str(self.group.parameters.get("condition", IDLE)))


def scenarios(study: Study) -> tuple[Scenario, ...]:
    """Every group of a study, and equal boards together; the worst answers first, then the highest values."""
    shown = [_scenario(group, label, study) for group, label in zip(study.answers, _labels(study), strict=True)]
    shown.sort(key=lambda scenario: severity(scenario.answer, scenario.figures.max_ns))
    seen: Counter[str] = Counter()
    for place, scenario in enumerate(shown):
        seen[scenario.id] += 1
        if seen[scenario.id] > 1:
            shown[place] = replace(scenario, id=f"{scenario.id}--{seen[scenario.id]}")
    return tuple(shown)


def _labels(study: Study) -> list[str]:
    """Suite and parameters, with the target and an idle condition where the scenarios of the study differ in them."""
    targets = {group.target for group in study.groups}
    loaded = any("condition" in group.parameters for group in study.groups)
    labels = []
    for group in study.answers:
        words = [group.label.replace("condition=", "")]
        words += [IDLE] * (loaded and "condition" not in group.parameters)
        words += [f"on {f'{len(group.boards)} boards' if group.members else group.target}"] * (len(targets) > 1)
        labels.append(printable(" ".join(words)))
    return labels


def _scenario(group: Group, label: str, study: Study) -> Scenario:
    line = verdict_line(group)
    outputs = {(digest.run, digest.header.output) for digest in group.digests}
    others = [digest for digest in study.others if (digest.run, digest.header.output) in outputs]
    every = [*group.digests, *others]
    return Scenario(
        id=re.sub("[^a-z0-9]+", "-", label.lower()).strip("-") or "scenario",
        label=label,
        answer=line.answer,
        text=line.text,
        group=group,
        figures=pool_figures(group.digests),
        tables=tuple(
            printable_table(table)
            for table in (_figures(every), _startup(every), _clusters(every), _rates(group), _costs(group))
            if table.rows
        ),
    )


def _figures(every: Sequence[Digest]) -> Table:
    """A row for each series, with its outputs as parts of the row. Losses are shown only where there were some."""
    losses = {**LOST, "skipped": "skipped"}
    lost = {name: losses[name] for name in losses if any(getattr(digest.header, name) for digest in every)}
    labels = output_labels(every)
    by_series: dict[str, list[int]] = {}
    for place, digest in enumerate(every):
        by_series.setdefault(digest.header.series, []).append(place)

    def row(name: str, series: str, figures: Figures, places: Sequence[int]) -> tuple[str, ...]:
        times = times_ns(figures)
        counts = (grouped(sum(getattr(every[k].header, what) for k in places)) for what in lost)
        return (name, series, *(time(times[what]) for what in _SHOWN), grouped(figures.n), *counts)

    rows: list[tuple[str, ...]] = []
    parts = {}
    for series, places in by_series.items():
        members = [every[k] for k in places]
        if len(members) > 1:
            parts[len(rows)] = tuple(row(labels[k], series, every[k].figures, [k]) for k in places)
        rows.append(row(_pool_label(members), series, pool_figures(members), places))
    notes = []
    if any(digest.header.startup for digest in every):
        notes.append("Start-up values (the first message, the first two periods) are in no figure: see below.")
    if any(0 < digest.n < 100_000 for digest in every):
        notes.append("A percentile of fewer values than it needs is their maximum.")
    if parts:
        notes.append("Percentiles of several outputs together are accurate to the width of a bin, 1 us.")
    if any(digest.header.series == MEASURED_2014 for digest in every):
        notes.append(NOTE_2014)
    notes += [f"{digest.header.output}: {remark}" for digest in every for remark in digest.header.remarks]
    return Table(
        id="figures",
        title="Figures",
        columns=("run", "series", *_SHOWN, "n", *lost.values()),
        rows=rows,
        parts=parts,
        numbers=range(2, 3 + len(_SHOWN) + len(lost)),
        notes=tuple(dict.fromkeys(notes)),
        how="figures",
    )


def output_labels(digests: Sequence[Digest]) -> list[str]:
    """Labels that distinguish these outputs: runs, numbers of subscribers, names of outputs, or a combination."""
    runs = {digest.run for digest in digests}
    series = Counter((digest.run, digest.header.series) for digest in digests)
    if max(series.values(), default=0) < 2:
        return [digest.run for digest in digests]
    labels, seen = [], Counter[tuple[str, str]]()
    for digest in digests:
        seen[digest.run, digest.header.series] += 1
        number = seen[digest.run, digest.header.series]
        label = f"subscriber {number}" if "subscribers" in digest.header.parameters else digest.header.output
        labels.append(label if len(runs) == 1 else f"{digest.run} {label}")
    return labels


def _pool_label(members: Sequence[Digest]) -> str:
    runs = dict.fromkeys(digest.run for digest in members)
    if len(members) == 1:
        return members[0].run
    what = "subscribers" if "subscribers" in members[0].header.parameters else "outputs"
    count = f"{len(members)} {what}" if len(members) > len(runs) else ""
    if len(runs) == 1:
        return f"{next(iter(runs))}, {count}"
    return f"all {len(runs)} runs" + (f", {count}" if count else "")


def _startup(every: Sequence[Digest]) -> Table:
    """A row for each series with the highest start-up value; the outputs are parts of the row."""
    by_series: dict[str, list[tuple[str, Digest]]] = {}
    for label, digest in zip(output_labels(every), every, strict=True):
        if digest.header.startup:
            by_series.setdefault(digest.header.series, []).append((label, digest))
    rows: list[tuple[str, ...]] = []
    parts = {}
    for series, members in by_series.items():
        outputs = tuple(
            (label, series, ", ".join(f"{time(v.value_ns)} (loop {v.index})" for v in digest.header.startup))
            for label, digest in members
        )
        if len(outputs) == 1:
            rows.append(outputs[0])
            continue
        parts[len(rows)] = outputs
        values_ns = [value.value_ns for _, digest in members for value in digest.header.startup]
        rows.append(
            (
                _pool_label([digest for _, digest in members]),
                series,
                f"{time(min(values_ns))} to {time(max(values_ns))}",
            )
        )
    return Table(
        id="startup", title="Start-up", columns=("run", "series", "values"), rows=rows, parts=parts, numbers=range(2, 3)
    )


def _clusters(every: Sequence[Digest]) -> Table:
    rows = []
    for digest in every:
        if digest.cluster is not None and digest.cluster.n:
            c = digest.cluster
            place = [time(value) for value in (c.median_ns, c.low_ns, c.high_ns)]
            rows.append((digest.run, CLUSTERED[digest.header.series], f"{100 * c.fraction:.3f}", *place))
    columns = ("run", "jitter", "share %", "median", "lowest", "highest")
    return Table(
        id="cluster", title="Negative cluster (below -500 us)", columns=columns, rows=rows, numbers=range(2, 6)
    )


def _rates(group: Group) -> Table:
    """The requested and the achieved rate of each periodic program."""
    rows = [
        (
            record.run,
            name,
            str(rate.asked_hz),
            *(_number(value) for value in (rate.achieved_hz, rate.overruns, rate.skipped)),
        )
        for record in group.records
        for name, rate in record.rates.items()
    ]
    columns = ("run", "program", "asked Hz", "achieved Hz", "overruns", "skipped periods")
    return Table(id="rates", title="Rates", columns=columns, rows=rows, numbers=range(2, 6))


def _costs(group: Group) -> Table:
    """What each program cost while it measured."""
    rows = [
        (
            record.run,
            program.name,
            str(costs.minor_faults),
            str(costs.major_faults),
            str(costs.voluntary_switches),
            str(costs.involuntary_switches),
            time(costs.cpu_time_ns / program.loops) if program.loops else "-",
        )
        for record in group.records
        for program in record.programs
        if (costs := program.costs)
    ]
    columns = ("run", "program", "minor faults", "major faults", "waited", "preempted", "CPU time a loop")
    notes = (
        "Of all threads of a program while it measured: page faults without and with reading from a disk, switches to "
        "other threads because it waited, and because it was preempted.",
    )
    return Table(id="costs", title="Costs", columns=columns, rows=rows, numbers=range(2, 7), notes=notes)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.7g}"
