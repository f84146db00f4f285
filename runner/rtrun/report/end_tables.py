"""The tables behind the scenarios: worst cases, layers, allocations, environment, reproduction."""

import hashlib
import json
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.analysis.tails.extreme_values import Bound
from rtrun.analysis.tails.worst_case import disagreement
from rtrun.judgement.groups import Group
from rtrun.judgement.influence import influences
from rtrun.judgement.layers import LayerPair
from rtrun.judgement.study import Study, environment, in_word
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.kinds.kind import Measure
from rtrun.kinds.lateness import LATENESS
from rtrun.plan.quantities import time_text
from rtrun.plan.question import NONE_TOLERATED
from rtrun.report import causes, influence, late_paths, layers
from rtrun.report.ranking import ranking
from rtrun.report.tables import Table, printable_table
from rtrun.report.topology_tables import bound_table, hop_table
from rtrun.report.tracing_cost import thresholds, tracing_cost
from rtrun.results.output import NON_MEASURING_THREADS
from rtrun.results.record import RunRecord


def end_tables(
    study: Study, pairs: Sequence[LayerPair], found: causes.Found, topologies: Sequence[MeasuredTopology]
) -> tuple[Table, ...]:
    """What stands behind the scenarios, each table with what came out of it.

    `pairs` are those of its layers, `found` is what its traces tell, `topologies` are those that were measured.
    """
    tables = [
        *_causes(study, found),
        tracing_cost(study),
        hop_table(topologies),
        bound_table(topologies),
        *(_of_paths(study) if topologies else ()),
        causes.periods(study.source, _judged(study))[0],
        causes.surroundings(study.source, _judged(study))[0],
        _worst_cases(study),
        ranking(study),
        layers.table(pairs, study.question.confidence),
        _allocations(study),
    ]
    return tuple(printable_table(table) for table in (*tables, _environment(study), _reproduce(study)) if table.rows)


def _of_paths(study: Study) -> Iterator[Table]:
    """Of topologies: where the time of late reactions went, and what other nodes added to it."""
    late, _ = late_paths.late_paths(study.source.folders)
    if late is not None:
        yield late
    yield influence.table(influences(study), study.question.confidence)


def _causes(study: Study, found: causes.Found) -> tuple[Table, Table]:
    ranking, explained, refused = found
    table = causes.table(ranking, explained)
    return replace(
        table, notes=(*table.notes, *thresholds(study.records, _judged(study)), *refused)
    ), causes.step_table(explained)


def _judged(study: Study) -> Measure:
    """The series that is judged; whatever a suite measures may be late."""
    return study.question.of or LATENESS


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
        title="Worst case by extreme value theory",
        columns=(
            "suite and parameters",
            "method",
            f"level exceeded once in {grouped(1 / study.question.probability)}",
            "found",
        ),
        rows=rows,
        outcome=_bounds_outcome(study),
        numbers=9,
        notes=("A bound is printed only where every assumption was tested and held.",),
        how="worst-case",
    )


def _given_bounds(study: Study) -> list[tuple[float, Group]]:
    """The upper ends of the bounds that may be given, with their groups."""
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
    scenarios = len({group.key for _, group in given})
    return f"a bound in {scenarios} of {len(study.groups)} scenarios, the highest {time(highest_ns)} for {label}"


def _bound(bound: Bound) -> tuple[str, str]:
    if bound.refused is not None or bound.level_ns is None or bound.low_ns is None or bound.high_ns is None:
        return "refused", bound.refused or "no level"
    return (
        f"{time(bound.level_ns)} ({100 * bound.confidence:g} % CI {time(bound.low_ns)} to {time(bound.high_ns)})",
        ", ".join(
            [
                f"shape {bound.shape:.3f}",
                counted(bound.points, "point"),
                *(f"{c.name} p = {c.p_value:.2g}" for c in bound.checks if c.p_value is not None),
            ]
        ),
    )


def _allocations(study: Study) -> Table:
    """How often the programs of runs that count it allocated and freed memory, beside their page faults."""
    rows = []
    for record in study.records:
        for program in record.programs:
            costs, loops = program.costs, program.loops
            if costs is None or costs.allocations is None:
                continue
            counts = (costs.allocations, costs.frees, costs.allocations_of_measuring_thread, costs.page_faults)
            each = f"{costs.allocations / loops:.3g}" if loops else "-"
            rows.append((record.run, program.name, *("-" if one is None else str(one) for one in counts), each))
    some = sum(row[2] != "0" for row in rows)
    columns = ("run", "program", "allocations", "frees", "in the measuring thread", "page faults", "allocations a loop")
    notes = (
        "Of all threads of a program while it measured: calls of malloc and its relatives, and of free. These runs "
        "count them, which costs time: their times are in no figure and no answer.",
    )
    outcome = f"{some} of {counted(len(rows), 'program')} allocated memory while measuring"
    return Table(
        id="allocations", title="Allocations", columns=columns, rows=rows, outcome=outcome, numbers=2, notes=notes
    )


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
            told = {
                "clock": effect.clock,
                "step of the clock": effect.clock_step_ns and time(effect.clock_step_ns),
                "memory is locked (mlockall)": effect.mlockall,
            }
            for key, value in told.items():
                if value is not None:
                    seen.setdefault(key, {})[in_word(value)] = None
    rows += [(key, "; ".join(sorted(values))) for key, values in seen.items()]
    outcome = (
        f"{len(rows)} facts about {', '.join(sorted({record.target.name for record in study.records})) or 'a file'}"
    )
    return Table(
        id="environment", title="Environment", columns=("what", "found"), rows=rows, outcome=outcome, numbers=9
    )


def _reproduce(study: Study) -> Table:
    rows = []
    alike = Counter(_as_asked(record) for record in study.records)
    for record in study.records:
        # Of repeated runs the first stands for all: 140 command lines are eight printed pages.
        if others := alike.pop(_as_asked(record), 0):
            lines = " ; ".join(shlex.join(program.argv) for program in record.programs)
            rows.append(("measured", f"{record.run}{f' and {others - 1} like it' if others > 1 else ''}: {lines}"))
    digest = fingerprint(study)
    asked = study.question
    of = f" --of {asked.of}" if asked.of else ""
    tolerate = f" --tolerate '{asked.tolerance}'" if asked.tolerance != NONE_TOLERATED else ""
    # What was observed has a deadline of its own, or none, unless one is named.
    is_for_all = all(group.question and group.question.deadline_ns == asked.deadline_ns for group in study.groups)
    deadline = f" --deadline {time_text(asked.deadline_ns)}" if is_for_all else ""
    command = f"rtrun report RESULTS{of}{tolerate}{deadline}"
    rows.append(("examined", f"{command} --probability {asked.probability!r} --confidence {asked.confidence!r}"))
    rows.append(("input", f"sha256 {digest} of all closing records"))
    rows.append(("seed", "20140715 for every resampling"))
    return Table(
        id="reproduce",
        title="How to reproduce",
        columns=("what", "how"),
        rows=rows,
        outcome=f"{counted(len(study.records), 'run')}, input sha256 {digest}",
        numbers=9,
    )


def _as_asked(record: RunRecord) -> str:
    return json.dumps([record.target.name, record.suite, record.circumstances], sort_keys=True)


def fingerprint(study: Study) -> str:
    """A hash of what was examined: the closing records, which hold the checksum of every file."""
    total = hashlib.sha256()
    paths = [folder / "run.json" for folder in study.source.folders] or [study.source.path]
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
