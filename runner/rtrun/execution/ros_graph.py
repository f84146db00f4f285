"""The graph of the nodes on a target, as ROS itself reports it: no probe is placed, and no program is touched.

With ROS 1, the master and its nodes are asked. ROS 2 has no master: a node with the environment of a program joins its
domain for some seconds, if the target has rclpy.
"""

import re
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Annotated, Any
from urllib.parse import urlsplit

from pydantic import Field

from rtfiles.config import Config, parse
from rtfiles.errors import UsageError
from rtfiles.untrusted import parse_json
from rtrun.execution.middleware import roscpp
from rtrun.probes.programs import ObservableProgram
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

# For all masters and domains together.
NODES_MAX = 2000  #: nodes of a graph, and topics or services of one
NAMES_MAX = 100_000  #: names that all nodes of a graph publish, take and serve
# How long a ROS 2 node looks around: it finds programs in some tenths of a second, on a slow board later.
LOOK_S = 3
# For all masters and domains together.
ASK_S = 60.0  #: asking for a graph of nodes
ROS1, ROS2 = "libroscpp", "librcl"
_MASTER, _DOMAIN = "ROS_MASTER_URI", "ROS_DOMAIN_ID"
_DEFAULT_MASTER = "http://localhost:11311"
# What every node has: logs, parameters, their services.
_OF_ROS = re.compile(
    r"/(?:rosout(?:_agg)?|parameter_events|clock)|.*/(?:get_loggers|set_logger_level|get_type_description|"
    r"(?:describe|get|list|set)_parameters(?:_atomically)?|get_parameter_types)"
)
# Prints the two variables of each process, one a line, after its pid.
_ASK_ENVIRONMENT = (
    'for pid; do tr "\\n\\0" "?\\n" <"/proc/$pid/environ" | '
    f'grep -E "^({_MASTER}|{_DOMAIN})=" | sed "s/^/$pid /"; done 2>/dev/null; exit 0'
)


class GraphNode(Config):
    """A node, with the names of what it publishes, takes and serves; `pid` if that is known."""

    name: str
    publishes: Annotated[list[str], Field(max_length=NODES_MAX)] = Field(default_factory=list)
    takes: Annotated[list[str], Field(max_length=NODES_MAX)] = Field(default_factory=list)
    serves: Annotated[list[str], Field(max_length=NODES_MAX)] = Field(default_factory=list)
    pid: int | None = None


class _Told(Config):
    """What ros2_graph.py prints."""

    nodes: Annotated[list[GraphNode], Field(max_length=NODES_MAX)]


@dataclass(frozen=True, kw_only=True, slots=True)
class RosGraph:
    """The known nodes, and the reasons why others are not known, one sentence each."""

    nodes: tuple[GraphNode, ...]
    remarks: tuple[str, ...]

    @property
    def topics(self) -> dict[str, tuple[list[str], list[str]]]:
        """By topic: the nodes that publish it, and those that take it."""
        ends: dict[str, tuple[list[str], list[str]]] = {}
        for node in self.nodes:
            for side, names in enumerate((node.publishes, node.takes)):
                for name in names:
                    ends.setdefault(name, ([], []))[side].append(node.name)
        return ends


def read_graph(link: Link, scripts: PurePosixPath, found: Sequence[ObservableProgram]) -> RosGraph:
    """Ask what the programs of a target see of one another. Raises TargetError where the target does not answer."""
    pids = {name: [observable.program.pid for observable in found if _has(observable, name)] for name in (ROS1, ROS2)}
    variables = _environment(link, [*pids[ROS1], *pids[ROS2]])
    nodes: list[GraphNode] = []
    remarks: list[str] = []
    end_s = time.monotonic() + ASK_S
    for master in dict.fromkeys(variables.get((pid, _MASTER), _DEFAULT_MASTER) for pid in pids[ROS1]):
        if time.monotonic() > end_s:
            remarks.append(f"the ROS master {master} was not asked: the others took {ASK_S:g} s")
            break
        try:
            nodes = _with(nodes, _ask_master(link, master, {observable.program.pid for observable in found}, end_s))
        except ConnectionRefusedError:
            remarks.append(f"the ROS master {master} does not answer on the target: its topics are seen once observed")
        except (TypeError, ValueError, UsageError) as error:
            remarks.append(f"the ROS master {master} does not answer as one: {error}")
    # One program per domain.
    domains = {variables.get((pid, _DOMAIN), "0"): pid for pid in reversed(pids[ROS2])}
    for domain, pid in domains.items():
        if time.monotonic() > end_s:
            remarks.append(f"the nodes of ROS 2 in domain {domain} are seen once observed: the others took {ASK_S:g} s")
            break
        try:
            nodes = _with(nodes, _join(link, scripts, pid))
        except UsageError as error:
            remarks.append(f"the nodes of ROS 2 in domain {domain} are seen once observed: {error}")
    if found:
        remarks.append("timers and their periods are seen once observed: nobody can be asked about them")
    return RosGraph(nodes=tuple(map(_without_those_of_ros, nodes)), remarks=tuple(remarks))


def _with(nodes: list[GraphNode], more: Iterable[GraphNode]) -> list[GraphNode]:
    """Add the nodes of one more master or domain. Raises UsageError if there are too many in total."""
    together = [*nodes, *more]
    names = sum(len(node.publishes) + len(node.takes) + len(node.serves) for node in together)
    if len(together) > NODES_MAX or names > NAMES_MAX:
        raise UsageError(f"there are more than {NODES_MAX} nodes, or {NAMES_MAX} names of what they have")
    return together


def _has(found: ObservableProgram, library: str) -> bool:
    return any(mapped.library == library for mapped in found.mapped)


def _without_those_of_ros(node: GraphNode) -> GraphNode:
    own = {
        key: sorted({name for name in getattr(node, key) if not _OF_ROS.fullmatch(name)})
        for key in ("publishes", "takes", "serves")
    }
    return node.model_copy(update=own)


def _environment(link: Link, pids: Iterable[int]) -> dict[tuple[int, str], str]:
    """The variables that tell processes which graph they belong to, by pid and name."""
    variables = {}
    for line in link.check(["sh", "-c", _ASK_ENVIRONMENT, "sh", *map(str, pids)]).splitlines():
        match = re.fullmatch(r"(\d{1,7}) (\w{1,32})=(.{0,500})", line, re.ASCII)
        if match:
            variables[int(match[1]), match[2]] = match[3]
    return variables


def _ask_master(link: Link, uri: str, pids: set[int], end_s: float) -> Iterator[GraphNode]:
    """The nodes of a ROS master on the target's loopback, with the pids of those that are observed.

    Nodes that are not asked before `end_s` (monotonic clock) have no pid.

    Raises ConnectionRefusedError if no master answers, ValueError or TypeError if the answer is not that of a master.
    """

    def ask(port: int, method: str, *arguments: str) -> Any:
        return link.do(lambda connection: roscpp.call(connection, port, method, *arguments))

    port = urlsplit(uri).port
    if not port:
        raise ValueError("it has no port")
    sides = ask(port, "getSystemState")
    names: dict[str, dict[str, list[str]]] = {}
    for key, side in zip(("publishes", "takes", "serves"), sides, strict=True):
        for name, nodes in side:
            for node in nodes:
                if not isinstance(node, str) or not isinstance(name, str):
                    raise ValueError("it has names that are no texts")
                names.setdefault(node, {}).setdefault(key, []).append(name)
    if len(names) > NODES_MAX:
        raise ValueError(f"it tells of more than {NODES_MAX} nodes")
    for node, of_node in names.items():
        pid = None
        try:
            # Every node may keep the runner waiting, and there may be many.
            own = urlsplit(str(ask(port, "lookupNode", node))).port if time.monotonic() < end_s else None
            pid = ask(own, "getPid") if own else None
        except (ConnectionRefusedError, TargetError, ValueError):
            # The node ended without telling the master, or is on another machine.
            pid = None
        # On this target the port may belong to another node.
        yield GraphNode(name=node, pid=pid if type(pid) is int and pid in pids else None, **of_node)


def _join(link: Link, scripts: PurePosixPath, pid: int) -> list[GraphNode]:
    """The nodes that a ROS 2 node sees in the domain of a program. Raises UsageError if it cannot be started there."""
    argv = ["python3", "-I", str(scripts / "ros2_graph.py"), str(pid), str(LOOK_S)]
    done = link.run(argv, deadline_s=ASK_S)
    if done.status != 0:
        raise UsageError(done.stderr.strip().rpartition("\n")[2][:200] or "the target has no python3")
    origin = "ros2_graph.py"
    return parse(parse_json(done.stdout.rstrip("\n").rpartition("\n")[2], origin), _Told, origin).nodes
