"""What a report says, as plain text and tables: written down by the HTML and the Markdown format alike."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rtfiles.output import printable
from rtrun.analysis.deadline import Answer, Verdict
from rtrun.analysis.extreme_values import Bound
from rtrun.analysis.figures import PERCENTILES, Figures
from rtrun.analysis.layers import attribute
from rtrun.analysis.worst_case import disagreement
from rtrun.plan.suites import suites
from rtrun.report.claims.examination import is_rt, select, us
from rtrun.report.claims.examiners import Examined
from rtrun.report.claims.reference import oneshot_rows, published
from rtrun.report.digest import Digest
from rtrun.report.study import Group, Study, environment, format_parameters
from rtrun.report.terminal import banner_of
from rtrun.results.samples import NON_MEASURING_THREADS
from rtrun.results.series import MEASURED_2014, NOTE_2014

# Fewer boots say too little of how boots differ: Student's t widens by more than twice (docs/analysis.md).
ENOUGH_BOOTS = 5


@dataclass(frozen=True, kw_only=True)
class Line:
    """A verdict: its answer, what it is about, and the numbers."""

    answer: str
    about: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text; cells from column `numbers` on hold numbers. ``notes`` stand below it."""

    id: str
    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    numbers: int = 1
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Document:
    """A report: the banner if there is one, verdicts, and tables in their order."""

    title: str
    banner: str | None
    summary: str
    question: str
    lines: tuple[Line, ...]
    tables: tuple[Table, ...]
    left_out: tuple[str, ...]


def document(study: Study, claims: Sequence[Examined]) -> Document:
    """Put a study into words."""
    tables = [_figures(study), *_startup(study), *_clusters(study), _worst_cases(study), *_layers(study)]
    tables += [_claims(claims), *_published(study), _environment(study), _reproduce(study)]
    return Document(
        title=printable(f"Real-time report: {study.source.path.resolve().name}"),
        banner=banner_of(emulated=study.emulated, preempt_rt=all(one.preempt_rt for one in study.records)) or None,
        summary=summary(study),
        question=f"Is P(value above {study.deadline_ns / 1000:g} us) below {study.probability:g}? "
        f"Confidence {100 * study.confidence:g} %, two-sided.",
        lines=tuple(verdict_line(group) for group in study.groups),
        tables=tuple(_printable(table) for table in tables if table.rows),
        left_out=tuple(map(printable, study.left_out)),
    )


def _printable(table: Table) -> Table:
    """The table without what would command a terminal, or cannot be encoded: much in it comes from a target."""
    return replace(
        table,
        rows=[tuple(map(printable, row)) for row in table.rows],
        notes=tuple(map(printable, table.notes)),
    )


def summary(study: Study) -> str:
    """How many groups got which answer, the worst first."""
    answers = [verdict_line(group).answer for group in study.groups]
    order = (Answer.REFUTED, Answer.NEEDS_MORE, Answer.IF_INDEPENDENT, Answer.PROVEN, Answer.NO_STATEMENT)
    return ", ".join(f"{answer} {answers.count(answer)} of {len(answers)}" for answer in order if answer in answers)


def verdict_line(group: Group) -> Line:
    """The verdict of a group in one line."""
    verdict, about = group.verdict, printable(group.label)
    if verdict is None:
        return Line(answer=Answer.NEEDS_MORE, about=about, text=group.undecidable or "nothing was measured")
    return Line(answer=verdict.answer, about=about, text=_numbers(verdict, group))


def _numbers(verdict: Verdict, group: Group) -> str:
    parts = [f"{verdict.late:,} of {verdict.n:,} late".replace(",", " ")]
    if verdict.absent:
        parts[0] += f" and {verdict.absent} never came"
    parts.append(f"P(miss) {_between(verdict)}")
    if verdict.worst_ns is not None:
        parts.append(f"worst {us(verdict.worst_ns)} us")
    if verdict.design_effect > 1.005:
        parts.append(f"dependent values: worth {verdict.n_effective:,.0f} independent measurements".replace(",", " "))
    if verdict.refused:
        parts.insert(0, verdict.refused)
    elif verdict.change is not None:
        change = f"it did not stay the same: {verdict.change.text} (p = {verdict.change.p_value:.1g})"
        parts.insert(0 if verdict.answer == Answer.NEEDS_MORE else len(parts), change)
    if verdict.answer == Answer.NEEDS_MORE:
        parts += _more(verdict)
    elif verdict.answer in (Answer.PROVEN, Answer.IF_INDEPENDENT):
        parts += _scope(verdict)
    startup_ns = [value.value_ns for one in group.digests for value in one.header.startup]
    late_start = [value_ns for value_ns in startup_ns if value_ns > verdict.deadline_ns]
    if late_start:
        parts.append(f"start-up apart: {len(late_start)} late, worst {us(max(late_start))} us")
    parts += [f"assumes {text}" for text in verdict.assumes]
    return "; ".join(parts)


def _between(verdict: Verdict) -> str:
    if verdict.lower == 0:
        return f"at most {verdict.upper:.2g}"
    return f"{verdict.lower:.2g} to {verdict.upper:.2g}"


def _scope(verdict: Verdict) -> list[str]:
    """What a proof holds for: bursts and boots."""
    covered = f"holds for bursts of up to {verdict.longest_burst:.0f} misses"
    more = [f"{_amount(verdict, count)} for bursts of {length}" for length, count in verdict.further_for_bursts]
    return [covered + (f" (without a miss, {', '.join(more)})" if more else ""), *_boots(verdict)]


def _boots(verdict: Verdict) -> list[str]:
    if verdict.boots is None:
        return []
    if verdict.boots == 1:
        return [f"holds for the boot that was measured; for the system measure on {ENOUGH_BOOTS} boots or more"]
    return [f"{verdict.boots} boots"] if verdict.boots >= ENOUGH_BOOTS else [f"{verdict.boots} boots only"]


def _more(verdict: Verdict) -> list[str]:
    parts = _boots(verdict)
    if verdict.change is not None:
        return parts
    if verdict.further is not None:
        parts.append(
            f"{_amount(verdict, verdict.further)} prove it without {'another' if verdict.misses else 'a'} miss"
            + (", if dependence stays as seen" if verdict.design_effect > 1.005 else "")
        )
    if verdict.further_likely is not None:
        answer, count = verdict.further_likely
        parts.append(f"at the rate seen, {answer} after {_amount(verdict, count)} nine times in ten")
    elif verdict.misses:
        parts.append("at the rate seen, no number is likely to decide it")
    return parts


def _amount(verdict: Verdict, count: int) -> str:
    hours = verdict.hours(count)
    return f"{count:,} more measurements".replace(",", " ") + (
        "" if hours is None else f" ({hours:.2g} h)" if hours < 10 else f" ({hours:.0f} h)"
    )


def _figures(study: Study) -> Table:
    columns: tuple[str, ...] = ("suite and parameters", "run", "series", "n", "min us", "mean us", "std us")
    columns += (*(f"p{p:g} us" for p in PERCENTILES), "max us", "missing", "out of order", "not fired")
    rows = [_row(one) for one in (*study.digests, *study.others)]
    notes = ["Start-up values (the first message, the first two periods) stand apart, as in the thesis."]
    notes.append("A percentile of fewer values than it needs is their maximum.")
    if any(one.header.series == MEASURED_2014 for one in (*study.digests, *study.others)):
        notes.append(NOTE_2014)
    notes += [
        f"{one.header.output}: {remark}" for one in (*study.digests, *study.others) for remark in one.header.remarks
    ]
    return Table(
        id="figures", title="Figures", columns=columns, rows=rows, numbers=3, notes=tuple(dict.fromkeys(notes))
    )


def _row(one: Digest) -> tuple[str, ...]:
    f: Figures = one.figures
    label = f"{one.header.suite.removesuffix('_tests')} {format_parameters(one.header.parameters)}"
    cells = [one.run, one.header.series, str(f.n), _time(f.min_ns), _time(f.mean_ns), _time(f.std_ns)]
    cells += [_time(f.percentiles_ns.get(p)) for p in PERCENTILES]
    cells += [_time(f.max_ns), str(one.header.missing), str(one.header.out_of_order), str(one.header.not_fired)]
    return (label, *cells)


def _time(value_ns: float | None) -> str:
    return "-" if value_ns is None or not math.isfinite(value_ns) else us(value_ns)


def _startup(study: Study) -> list[Table]:
    rows = [
        (
            one.run,
            one.header.output,
            one.header.series,
            ", ".join(f"{us(value.value_ns)} (loop {value.index})" for value in one.header.startup),
        )
        for one in (*study.digests, *study.others)
        if one.header.startup
    ]
    return [Table(id="startup", title="Start-up", columns=("run", "output", "series", "us"), rows=rows, numbers=3)]


def _clusters(study: Study) -> list[Table]:
    rows = []
    for one in (*study.digests, *study.others):
        if one.cluster is not None and one.n:
            c = one.cluster
            place = [_time(value) for value in (c.median_ns, c.low_ns, c.high_ns)]
            rows.append(
                (one.run, "successive" if one.header.series == "jitter" else "grid", f"{100 * c.fraction:.3f}", *place)
            )
    columns = ("run", "jitter", "share %", "median us", "lowest us", "highest us")
    return [Table(id="cluster", title="Negative cluster (below -500 us)", columns=columns, rows=rows, numbers=2)]


def _worst_cases(study: Study) -> Table:
    rows = []
    for group in study.groups:
        if group.no_bound:
            rows.append((group.label, "-", "refused", group.no_bound))
        rows += [(group.label, bound.method, *_bound(bound)) for bound in group.bounds]
        if (text := disagreement(group.bounds)) is not None:
            rows.append((group.label, "-", "doubtful", text))
    return Table(
        id="worst-case",
        title="Worst case by extreme value theory",
        columns=("suite and parameters", "method", f"level exceeded once in {1 / study.probability:.3g}", "found"),
        rows=rows,
        numbers=9,
        notes=("A bound is printed only where every assumption was tested and held.",),
    )


def _bound(bound: Bound) -> tuple[str, str]:
    if bound.refused is not None or bound.level_ns is None or bound.low_ns is None or bound.high_ns is None:
        return "refused", bound.refused or "no level"
    return (
        f"{us(bound.level_ns)} us ({100 * bound.confidence:g} % CI {us(bound.low_ns)} to {us(bound.high_ns)} us)",
        f"shape {bound.shape:.3f}, {bound.points} points, "
        + ", ".join(f"{c.name} p = {c.p_value:.2g}" for c in bound.checks if c.p_value is not None),
    )


# Parameters of a layer alone; all others must be the same in both.
_OF_A_LAYER = {"timeout_us", "interval_us", "frequency_hz", "busy_mode", "threads", "payload_bytes", "subscribers"}


def _layers(study: Study) -> list[Table]:
    """What each layer adds to the one below, for every pair of groups that differ in nothing but the layer."""
    if study.emulated:
        return []
    rows = []
    for low_name, high_name in (("cyclictest", "oneshot_timer_tests"), ("oneshot_timer_tests", "communication_tests")):
        for low in select(study.groups, low_name):
            for high in select(study.groups, high_name):
                if not _differ_in_layer(low, high):
                    continue
                attribution = attribute(low.blocks, high.blocks, confidence=study.confidence)
                if attribution.refused:
                    rows.append((low.label, high.label, "-", "-", "-", f"refused: {attribution.refused}"))
                for added in attribution.added:
                    interval = f"{added.low_ns / 1000:+.1f} to {added.high_ns / 1000:+.1f}"
                    adds = f"{added.added_ns / 1000:+.1f}"
                    rows.append((low.label, high.label, added.figure, adds, interval, added.method))
    columns = ("layer", "layer above", "figure", "adds us", f"{100 * study.confidence:g} % CI us", "method")
    return [Table(id="layers", title="What each layer adds", columns=columns, rows=rows, numbers=9)]


def _differ_in_layer(low: Group, high: Group) -> bool:
    """Whether two groups with real-time policy differ in the layer alone: same target, priority, condition, period."""
    alike = low.target == high.target and _others(low) == _others(high) and _period_us(low) == _period_us(high)
    means_known = all(one.figures.mean_ns is not None for group in (low, high) for one in group.digests)
    one_event = all(group.parameters.get(key, 1) == 1 for group in (low, high) for key in ("subscribers", "threads"))
    return alike and means_known and one_event and is_rt(high) and bool(low.blocks and high.blocks)


def _others(group: Group) -> dict[str, object]:
    """Parameters that are not of one layer alone and not the default: a suite without an option has its default."""
    options = suites().options
    given = {
        key: value for key, value in group.parameters.items() if key not in _OF_A_LAYER and value not in (None, "")
    }
    return {key: value for key, value in given.items() if key not in options or value != options[key].default}


def _period_us(group: Group) -> float | None:
    """Time between two measurements as asked for."""
    for key in ("timeout_us", "interval_us"):
        value = group.parameters.get(key)
        if isinstance(value, int):
            return float(value)
    frequency = group.parameters.get("frequency_hz")
    return 1e6 / frequency if isinstance(frequency, int) and frequency else None


def _claims(claims: Sequence[Examined]) -> Table:
    rows = [
        (c.result.finding, c.id, c.section, c.text, c.result.numbers, c.result.test, _few(c.result.runs))
        for c in claims
    ]
    return Table(
        id="claims",
        title="Claims of the thesis, re-examined",
        columns=("found", "claim", "section", "text", "numbers", "test", "runs"),
        rows=[tuple(map(str, row)) for row in rows],
        numbers=9,
    )


def _few(runs: Sequence[str]) -> str:
    return ", ".join(runs[:3]) + (f" and {len(runs) - 3} more" if len(runs) > 3 else "")


def _published(study: Study) -> list[Table]:
    rows = []
    for group in select(study.as_in_2014, "oneshot_timer_tests"):
        timeout = group.parameters.get("timeout_us")
        if not isinstance(timeout, int):
            continue
        for row in oneshot_rows(str(group.parameters.get("policy", "0")), timeout):
            there = f"PandaBoard ES 2014, {row['kernel']}, {row['cpu_load_percent']} % load"
            rows.append((group.label, there, *_here(group), *(str(row[k]) for k in ("min_us", "avg_us", "max_us"))))
    for group in select(study.as_in_2014, "communication_tests", rt=True):
        known = published()["thesis_figures"]["communication_fig_4_3"]
        if (group.parameters.get("frequency_hz"), group.parameters.get("subscribers", 1)) == (100, 1):
            numbers = [str(known[f"rest_{k}_us"]) for k in ("min", "avg", "max")]
            rows.append((group.label, "PandaBoard ES 2014, figure 4.3", *_here(group), *numbers))
    columns = (
        "suite and parameters",
        "beside",
        "min us",
        "mean us",
        "max us",
        "2014 min us",
        "2014 mean us",
        "2014 max us",
    )
    note = "Another board, kernel or ROS: a difference says nothing about any one of them alone."
    return [
        Table(
            id="published",
            title="Beside the published PandaBoard figures",
            columns=columns,
            rows=rows,
            numbers=2,
            notes=(note,),
        )
    ]


def _here(group: Group) -> tuple[str, str, str]:
    lows = [d.figures.min_ns for d in group.digests if d.figures.min_ns is not None]
    highs = [d.figures.max_ns for d in group.digests if d.figures.max_ns is not None]
    means = [(d.figures.mean_ns * d.n, d.n) for d in group.digests if d.figures.mean_ns is not None]
    mean = sum(total for total, _ in means) / sum(n for _, n in means) if means else None
    return _time(min(lows, default=None)), _time(mean), _time(max(highs, default=None))


def _environment(study: Study) -> Table:
    rows = [(key.replace("_", " "), value) for key, value in environment(study.records)]
    seen: dict[str, dict[str, None]] = {}
    for one in study.digests:
        effect = one.header.in_effect
        if effect:
            policies = {
                f"{thread.policy} {thread.priority}": None
                for thread in effect.threads
                if thread.name not in NON_MEASURING_THREADS
            }
            asked = str(one.header.parameters.get("policy", "0"))
            seen.setdefault(f"threads in effect, policy {asked} asked for", {}).update(policies)
            for key in ("clock", "clock_step_ns", "mlockall"):
                seen.setdefault(key.replace("_", " "), {})[str(getattr(effect, key))] = None
    rows += [(key, "; ".join(sorted(values))) for key, values in seen.items()]
    return Table(id="environment", title="Environment", columns=("what", "found"), rows=rows, numbers=9)


def _reproduce(study: Study) -> Table:
    rows = [
        ("measured", f"{record.run}: {' ; '.join(' '.join(p.argv) for p in record.programs)}")
        for record in study.records
    ]
    command = f"rtrun report RESULTS --deadline {study.deadline_ns / 1000:g}us"
    rows.append(("examined", f"{command} --probability {study.probability:g} --confidence {study.confidence:g}"))
    rows.append(("input", f"sha256 {fingerprint(study)} of all closing records"))
    rows.append(("seed", "20140715 for every resampling"))
    return Table(id="reproduce", title="How to reproduce", columns=("what", "how"), rows=rows, numbers=9)


def fingerprint(study: Study) -> str:
    """A hash of what was examined: the closing records, which hold the checksum of every file."""
    total = hashlib.sha256()
    paths = [folder / "run.json" for folder in study.source.folders] or [study.source.path]
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
