"""The tables behind the scenarios: worst cases, layers, published figures, environment, reproduction."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

from rtfiles.output import counted
from rtfiles.quantities import time_us, us
from rtrun.analysis.extreme_values import Bound
from rtrun.analysis.layers import attribute
from rtrun.analysis.worst_case import disagreement
from rtrun.judgement.claims.examination import is_rt, select
from rtrun.judgement.claims.reference import message_rows, oneshot_rows
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study, environment
from rtrun.kinds.known import KINDS
from rtrun.kinds.output import NON_MEASURING_THREADS
from rtrun.plan.question import NONE_TOLERATED
from rtrun.plan.suites import suites
from rtrun.report import causes
from rtrun.report.tables import Table, how, printable_table
from rtrun.report.tracing_cost import thresholds, tracing_cost
from rtrun.targets.inspection.platform import Platform

WORST_CASE = "Worst case by extreme value theory"


def end_tables(study: Study) -> tuple[Table, ...]:
    """What stands behind the scenarios, each table with what came out of it."""
    tables = [
        *_causes(study),
        tracing_cost(study),
        causes.periods(study.source)[0],
        causes.surroundings(study.source)[0],
        _worst_cases(study),
        _layers(study),
        _published(study),
    ]
    return tuple(printable_table(table) for table in (*tables, _environment(study), _reproduce(study)) if table.rows)


def _causes(study: Study) -> tuple[Table, Table]:
    ranking, explained, refused = causes.ranked(study.source)
    table = causes.table(ranking, explained)
    return replace(table, notes=(*table.notes, *thresholds(study.records), *refused)), causes.step_table(explained)


def _worst_cases(study: Study) -> Table:
    rows: list[tuple[str, ...]] = []
    for group in study.groups if _given_bounds(study) else ():
        if group.no_bound:
            rows.append((group.label, "-", "refused", group.no_bound))
        rows += [(group.label, bound.method, *_bound(bound)) for bound in group.bounds]
        if (text := disagreement(group.bounds)) is not None:
            rows.append((group.label, "-", "doubtful", text))
    return Table(
        id="worst-case",
        title=WORST_CASE,
        columns=(
            "suite and parameters",
            "method",
            f"level exceeded once in {1 / study.question.probability:.3g}",
            "found",
        ),
        rows=rows,
        outcome=_bounds_outcome(study),
        numbers=9,
        notes=("A bound is printed only where every assumption was tested and held.", how("Worst case")),
    )


def _given_bounds(study: Study) -> list[tuple[float, Group]]:
    """The upper ends of the bounds that may be given, and what they are of."""
    return [
        (bound.high_ns, group)
        for group in study.groups
        for bound in group.bounds
        if bound.refused is None and bound.high_ns is not None
    ]


def _bounds_outcome(study: Study) -> str:
    """In how many scenarios a bound may be given, and the highest one."""
    given = _given_bounds(study)
    highest_ns, label = max(((high_ns, group.label) for high_ns, group in given), default=(0.0, ""))
    scenarios = len({id(group) for _, group in given})
    return f"a bound in {scenarios} of {len(study.groups)} scenarios, the highest {us(highest_ns)} us for {label}"


def worst_cases_in_short(study: Study) -> str:
    """What is said where no bound may be given, so that there is no table; empty where there is one."""
    if not study.groups or _given_bounds(study):
        return ""
    reasons = dict.fromkeys(group.no_bound for group in study.groups)
    reason = reasons.popitem()[0] if len(reasons) == 1 else None
    return (
        f"{WORST_CASE}: no bound in any of {counted(len(study.groups), 'scenario')}: "
        f"{reason or '--format json has the reasons'}. {how('Worst case')}"
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
_UNLIKE_IDLE = (
    "idle CPUs were kept awake in one and not in the other; give both the same cpu_dma_latency_us, of which cyclictest "
    "has 0 by default and the suites none"
)


def _layers(study: Study) -> Table:
    """What each layer adds to the one below, for every pair of groups that differ in nothing but the layer."""
    rows: list[tuple[str, ...]] = []
    groups = () if study.platform is Platform.EMULATED else study.groups
    for low, high, above in _pairs_of_layers(groups):
        labels = low.label, high.label
        if _awake_us(low) != _awake_us(high):
            if not _has_like(low, above):
                rows.append((*labels, "-", "-", "-", f"refused: {_UNLIKE_IDLE}"))
            continue
        attribution = attribute(low.blocks, high.blocks, confidence=study.question.confidence)
        if attribution.refused:
            rows.append((*labels, "-", "-", "-", f"refused: {attribution.refused}"))
        for added in attribution.added:
            interval = f"{added.low_ns / 1000:+.1f} to {added.high_ns / 1000:+.1f}"
            rows.append((*labels, added.figure, f"{added.added_ns / 1000:+.1f}", interval, added.method))
    columns = ("layer", "layer above", "figure", "adds us", f"{100 * study.question.confidence:g} % CI us", "method")
    outcome = f"{len({row[:2] for row in rows})} pairs of layers compared"
    return Table(
        id="layers",
        title="What each layer adds",
        columns=columns,
        rows=rows,
        outcome=outcome,
        numbers=9,
        notes=(how("Comparison"),),
    )


def _pairs_of_layers(groups: Sequence[Group]) -> Iterator[tuple[Group, Group, list[Group]]]:
    """Yield a group, one that differs from it in the layer alone, and all groups of that one's kind."""
    for kind in KINDS.values():
        above = select(groups, kind)
        below = select(groups, KINDS.get(kind.layer_below, kind.layer_below))
        yield from ((low, high, above) for low in below for high in above if _differ_in_layer(low, high))


def _differ_in_layer(low: Group, high: Group) -> bool:
    """Whether two groups with real-time policy differ in the layer alone: same target, priority, condition, period."""
    alike = low.target == high.target and _others(low) == _others(high) and _period_us(low) == _period_us(high)
    means_known = all(one.figures.mean_ns is not None for group in (low, high) for one in group.digests)
    one_event = all(group.parameters.get(key, 1) == 1 for group in (low, high) for key in ("subscribers", "threads"))
    return alike and means_known and one_event and is_rt(high) and bool(low.blocks and high.blocks)


def _awake_us(group: Group) -> object:
    """The latency at which idle CPUs were kept awake; None where they slept as they would."""
    return group.parameters.get("cpu_dma_latency_us")


def _has_like(low: Group, above: Sequence[Group]) -> bool:
    """Whether one of the layer above was measured with idle CPUs as this one was."""
    return any(_differ_in_layer(low, high) and _awake_us(low) == _awake_us(high) for high in above)


def _others(group: Group) -> dict[str, object]:
    """Parameters that are not of one layer alone and not the default: a suite without an option has its default."""
    options = suites().options
    given = {
        key: value
        for key, value in group.parameters.items()
        if key not in _OF_A_LAYER | {"cpu_dma_latency_us"} and value not in (None, "")
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


def _published(study: Study) -> Table:
    of_table, others = oneshot_rows(), message_rows()
    matched = [(row, group) for group in study.as_in_2014 for row in (*of_table, *others) if row.is_like(group)]
    measured = sum(any(row is each for each, _ in matched) for row in of_table)
    columns_here, columns_there = ("min us", "mean us", "max us"), ("2014 min us", "2014 mean us", "2014 max us")
    return Table(
        id="published",
        title="Beside the published PandaBoard figures",
        columns=("suite and parameters", "published", *columns_here, *columns_there),
        rows=[(group.label, row.place, *_here(group), *map(str, row.figures_us)) for row, group in matched],
        outcome=f"{measured} of the {len(of_table)} rows of the one-shot table were measured here",
        numbers=2,
        notes=("Another board, kernel or ROS: a difference says nothing about any one of them alone.",),
    )


def _here(group: Group) -> tuple[str, str, str]:
    lows = [d.figures.min_ns for d in group.digests if d.figures.min_ns is not None]
    highs = [d.figures.max_ns for d in group.digests if d.figures.max_ns is not None]
    means = [(d.figures.mean_ns * d.n, d.n) for d in group.digests if d.figures.mean_ns is not None]
    mean = sum(total for total, _ in means) / sum(n for _, n in means) if means else None
    return time_us(min(lows, default=None)), time_us(mean), time_us(max(highs, default=None))


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
    outcome = (
        f"{len(rows)} facts about {', '.join(sorted({record.target.name for record in study.records})) or 'a file'}"
    )
    return Table(
        id="environment", title="Environment", columns=("what", "found"), rows=rows, outcome=outcome, numbers=9
    )


def _reproduce(study: Study) -> Table:
    rows = [
        ("measured", f"{record.run}: {' ; '.join(' '.join(p.argv) for p in record.programs)}")
        for record in study.records
    ]
    digest = fingerprint(study)
    asked = study.question
    of = f" --of {asked.of}" if asked.of else ""
    tolerate = f" --tolerate '{asked.tolerance}'" if asked.tolerance != NONE_TOLERATED else ""
    command = f"rtrun report RESULTS{of}{tolerate} --deadline {asked.deadline_ns / 1000:g}us"
    rows.append(("examined", f"{command} --probability {asked.probability:g} --confidence {asked.confidence:g}"))
    rows.append(("input", f"sha256 {digest} of all closing records"))
    rows.append(("seed", "20140715 for every resampling"))
    return Table(
        id="reproduce",
        title="How to reproduce",
        columns=("what", "how"),
        rows=rows,
        outcome=f"{len(study.records)} runs, input sha256 {digest}",
        numbers=9,
    )


def fingerprint(study: Study) -> str:
    """A hash of what was examined: the closing records, which hold the checksum of every file."""
    total = hashlib.sha256()
    paths = [folder / "run.json" for folder in study.source.folders] or [study.source.path]
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
