"""The topologies of a study: runs of one graph under the same circumstances are combined."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rtrun.judgement.study import Study
from rtrun.kinds.path import STREAM as PATH
from rtrun.plan.observation import StreamDeadline
from rtrun.plan.short_names import format_parameters
from rtrun.plan.suites import telling_parameters
from rtrun.plan.topology.planning import SUITE, own_deadlines
from rtrun.results.record import RunRecord, RunStatus
from rtrun.results.topology_record import (
    HopFigures,
    NodeFigures,
    PathFigures,
    Spread,
    TopologyRecord,
    read_topology_record,
)


@dataclass(frozen=True, kw_only=True)
class MeasuredTopology:
    """Runs of a topology that are alike.

    `nodes` and `hops` combine all runs: counts are added up, and the worst times taken. `shown` is the run whose
    critical path took longest; `run` is its name.
    """

    label: str
    run: str
    shown: TopologyRecord
    nodes: tuple[NodeFigures, ...]
    hops: tuple[HopFigures, ...]
    records: tuple[RunRecord, ...]

    @property
    def critical(self) -> PathFigures | None:
        """The critical path in `shown`; None: no path was measured."""
        return _critical(self.shown)


def measured_topologies(study: Study) -> tuple[MeasuredTopology, ...]:
    """The topologies of a study, in the order of their first run. Raises UsageError for a damaged topology.json."""
    folders = {folder.name: folder for folder in study.source.folders}
    alike: dict[str, list[tuple[RunRecord, TopologyRecord]]] = {}
    for record in study.records:
        if record.suite == SUITE and record.status is RunStatus.OK and record.run in folders:
            found = read_topology_record(folders[record.run])
            if found is not None:
                alike.setdefault(_label(record), []).append((record, found))
    return tuple(_together(label, runs) for label, runs in alike.items())


def _label(record: RunRecord) -> str:
    """Which topology, through what, under which circumstances, and where."""
    parameters = telling_parameters(record.circumstances)
    through = f"{parameters.pop('topology', '')} through {parameters.pop('middleware', '')}"
    return f"{' '.join(filter(None, (through, format_parameters(parameters))))} on {record.target.name}"


def _together(label: str, runs: Sequence[tuple[RunRecord, TopologyRecord]]) -> MeasuredTopology:
    worst, shown = max(runs, key=lambda run: _longest_ns(run[1]))
    figures = [found for _, found in runs]
    return MeasuredTopology(
        label=label,
        run=worst.run,
        shown=shown,
        nodes=tuple(
            _node([own for found in figures for own in found.nodes if own.node == node.node]) for node in shown.nodes
        ),
        hops=tuple(
            _hop(
                [
                    own
                    for found in figures
                    for own in found.hops
                    if (own.topic, own.subscriber) == (hop.topic, hop.subscriber)
                ]
            )
            for hop in shown.hops
        ),
        records=tuple(record for record, _ in runs),
    )


def _longest_ns(found: TopologyRecord) -> int:
    path = _critical(found)
    return path.reaction.max_ns or 0 if path else 0


def _critical(found: TopologyRecord) -> PathFigures | None:
    """The path whose reaction is the largest part of its deadline; where none has one, the longest reaction."""
    deadlines = {deadline.name: deadline for deadline in own_deadlines(found.topology) if deadline.stream is PATH}
    measured = [path for path in found.paths if path.reaction.max_ns is not None]
    with_deadline = [path for path in measured if ",".join(path.topics) in deadlines]
    return max(with_deadline or measured, key=lambda path: _urgency(path, deadlines), default=None)


def _urgency(path: PathFigures, deadlines: dict[str, StreamDeadline]) -> float:
    deadline = deadlines.get(",".join(path.topics))
    return (path.reaction.max_ns or 0) / (deadline.deadline_ns if deadline else 1)


def _node(alike: Sequence[NodeFigures]) -> NodeFigures:
    return NodeFigures(
        node=alike[0].node,
        activations=sum(figures.activations for figures in alike),
        overruns=sum(figures.overruns for figures in alike),
        cpu=_worst(figures.cpu for figures in alike),
        response=_worst(figures.response for figures in alike),
        lateness=_worst(figures.lateness for figures in alike),
    )


def _hop(alike: Sequence[HopFigures]) -> HopFigures:
    causes = dict.fromkeys(cause for figures in alike for cause in figures.lost)
    return HopFigures(
        topic=alike[0].topic,
        publisher=alike[0].publisher,
        subscriber=alike[0].subscriber,
        sent=sum(figures.sent for figures in alike),
        taken=sum(figures.taken for figures in alike),
        overwritten=sum(figures.overwritten for figures in alike),
        unused=sum(figures.unused for figures in alike),
        lost={cause: sum(figures.lost.get(cause, 0) for figures in alike) for cause in causes},
        latency=_worst(figures.latency for figures in alike),
    )


def _worst(spreads: Iterable[Spread]) -> Spread:
    """The largest of all; a median of several runs cannot be derived from their medians."""
    known = [spread for spread in spreads if spread.max_ns is not None]
    median_ns = known[0].median_ns if len(known) == 1 else None
    return Spread(
        median_ns=median_ns, max_ns=max((spread.max_ns for spread in known if spread.max_ns is not None), default=None)
    )
