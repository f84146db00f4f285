"""What a run measures of a topology: which paths, and which deadlines."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

from rtfiles.config import Place
from rtfiles.output import listed
from rtfiles.quantities import grouped
from rtrun.kinds.age import STREAM as AGE
from rtrun.kinds.path import STREAM as PATH
from rtrun.kinds.response import STREAM as RESPONSE
from rtrun.kinds.timer import STREAM as TIMER
from rtrun.plan.observation import StreamDeadline
from rtrun.plan.topology.others import beside, read_other_nodes
from rtrun.plan.topology.rates import most_activations
from rtrun.plan.topology.topology import NodePath, Topology

SUITE = "topology"
"""The suite of a run of a topology, whose streams are runs of the suites of their kinds."""
PATHS_MAX = 32  #: paths of a topology that are measured by default
"""If no paths are named, this many are measured, the longest ones: each becomes a run directory."""

ACTIVATIONS_MAX = 10**9  #: activations of a node of a topology in a run; its program keeps a row of each
WARM_UP_NS = 500_000_000
"""How long the topology runs before the measuring; no stream includes this time."""
_NAMED = 4

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class TopologyPlan:
    """What a run of a topology measures: how long after the common start, which paths, and which deadlines."""

    word: ClassVar[str] = "topology"
    is_observed: ClassVar[bool] = False
    makes_streams: ClassVar[bool] = True

    topology: Topology
    for_s: float
    paths: tuple[NodePath, ...]
    deadlines: tuple[StreamDeadline, ...] = ()
    others: tuple[str, ...] = ()
    """Nodes of the topology that are not measured: nothing of them is kept."""

    @property
    def measure_ns(self) -> int:
        """For how long after the start new periods begin."""
        return measure_ns(self.for_s)

    def beside(self, text: str) -> "TopologyPlan":
        """The plan with other nodes added, in the form of `read_other_nodes`; empty: none. Raises ValueError."""
        if not text:
            return self
        topology, others = beside(self.topology, read_other_nodes(text))
        return replace(self, topology=topology, others=others)


def measure_ns(for_s: float) -> int:
    """For how long after the start new periods begin, in a run that measures for `for_s` seconds."""
    return WARM_UP_NS + round(for_s * 1e9)


def plan_topology(
    topology: Topology,
    for_s: float,
    *,
    paths: Sequence[tuple[str, ...]] = (),
    deadlines: Sequence[StreamDeadline] = (),
    where: Place,
    errors: list[str],
) -> TopologyPlan | None:
    """Plan what to measure of a topology: the paths that it and a campaign name, and the paths of deadlines.

    If no path is named, all paths from source to sink, of more than `PATHS_MAX` the longest ones. Returns None if the
    campaign, which is at `where`, names paths or deadlines of something that does not exist, or a node would be
    activated more than `ACTIVATIONS_MAX` times; `errors` then gets the mistakes, one a line.
    """
    before = len(errors)
    rows = most_activations(topology, measure_ns(for_s))
    if often := [name for name, number in rows.items() if number > ACTIVATIONS_MAX]:
        most = f"more than {grouped(ACTIVATIONS_MAX)} times in a run"
        errors.append(f"{where}: {topology.name} would activate {listed(often, _NAMED)} {most}, and keeps each")
    _check_each(where / "paths", paths, topology.paths_of, errors)
    _check_each(where / "deadlines", deadlines, lambda deadline: check_deadline(topology, deadline), errors)
    if len(errors) > before:
        return None
    # A deadline of the campaign overrides that of the topology.
    deadlines = tuple(
        {(deadline.kind, deadline.name): deadline for deadline in (*own_deadlines(topology), *deadlines)}.values()
    )
    of_deadlines = (tuple(deadline.name.split(",")) for deadline in deadlines if deadline.stream.is_of_paths)
    named = dict.fromkeys((*(path.topics for path in topology.paths), *paths, *of_deadlines))
    followed = tuple(path for topics in named for path in topology.paths_of(topics))
    if not named:
        longest = sorted(topology.all_paths(), key=lambda path: -len(path.topics))
        followed = tuple(longest[:PATHS_MAX])
    return TopologyPlan(topology=topology, for_s=for_s, paths=followed, deadlines=deadlines)


def _check_each(where: Place, items: Sequence[T], check: Callable[[T], object], errors: list[str]) -> None:
    for number, item in enumerate(items):
        try:
            check(item)
        except ValueError as error:
            errors.append(f"{where / number}: {error}")


def own_deadlines(topology: Topology) -> Iterator[StreamDeadline]:
    """The deadlines in the topology file."""
    for node in topology.nodes:
        if node.deadline_ns:
            yield StreamDeadline(kind=RESPONSE.word, name=node.full_name, deadline_ns=node.deadline_ns)
    for path in topology.paths:
        for kind, deadline_ns in ((PATH.word, path.reaction_ns), (AGE.word, path.age_ns)):
            if deadline_ns:
                yield StreamDeadline(kind=kind, name=",".join(path.topics), deadline_ns=deadline_ns)


def check_deadline(topology: Topology, deadline: StreamDeadline) -> None:
    """Refuse a deadline of something that does not exist. Raises ValueError."""
    if deadline.stream.is_of_paths:
        topology.paths_of(tuple(deadline.name.split(",")))
    elif deadline.stream.named_by == "topic":
        if not topology.takers.get(deadline.name):
            taken = ", ".join(topic for topic, takers in topology.takers.items() if takers)
            raise ValueError(f"{deadline.text}: no node takes {deadline.name}, taken are {taken}")
    else:
        names = {node.full_name for node in topology.nodes if deadline.stream is not TIMER or node.period_ns > 0}
        if deadline.name not in names:
            what = "node with a period" if deadline.stream is TIMER else "node"
            known = ", ".join(sorted(names)) or "none"
            raise ValueError(f"{deadline.text}: no {what} is called {deadline.name}, there are {known}")
