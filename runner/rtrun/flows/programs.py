"""Observed processes while they live, and names of their nodes and things that stay the same after a restart."""

import re
from collections import Counter
from collections.abc import Hashable
from typing import Any, Generic, Protocol, TypeVar

from rtrun.probes.hits import ObservedProgram, script_of
from rtrun.probes.libraries.description import libraries

T = TypeVar("T")
_REMAPPED = re.compile(r"(?:[^:=]*:)?__(node|name|ns):=(.*)", re.DOTALL)

NAME_CHARACTERS_MAX = 512  #: characters of the name of a topic, node or namespace; ROS 2 allows 255
_TIDY_FROM = 50_000  # names, most of them of things that have ended

Handle = int | str
"""What tells one thing from another in its process: a pointer."""


class LivingProcess:
    """A process from its first hit to its end. `label` names its node, or the program if no node is known.

    `has_shown_callbacks`: a hit of rclcpp was seen, which shows where callbacks begin. `passes_pointers`: messages
    were seen to be passed on within it (intra-process communication).
    """

    __slots__ = (
        "ended_feed", "has_own_name", "has_shown_callbacks", "is_alive", "label", "labels", "names_of_nodes",
        "passes_pointers", "pid", "program", "tables",
    )  # fmt: skip

    def __init__(self, pid: int, program: ObservedProgram | None, *, has_own_name: bool = False) -> None:
        self.pid = pid
        self.program = program
        # The pid of an unknown process is minus the id of its thread.
        unknown = f"process {pid}" if pid > 0 else f"process of thread {-pid}"
        self.label = unknown if program is None else label_of(program)
        self.is_alive = True
        self.ended_feed = 0
        """Which feed was the next one when it was seen to have ended."""
        self.has_own_name = has_own_name
        self.has_shown_callbacks = self.passes_pointers = False
        self.names_of_nodes: dict[Handle, str] = {}
        self.labels: dict[str, str] = {}
        """By names of its nodes: these names, numbered where another process has the same."""
        self.tables: dict[HandleTable[Any], dict[Handle, Any]] = {}

    @property
    def shows_callbacks(self) -> bool:
        """Whether it is of rclcpp, which shows where callbacks begin."""
        return self.has_shown_callbacks or (self.program is not None and _is_of_rclcpp(self.program))

    @property
    def things(self) -> int:
        """How many things it has, itself included."""
        return 1 + len(self.names_of_nodes) + sum(map(len, self.tables.values()))

    def node(self, handle: Handle | None) -> str:
        """The name of a node that was seen to begin; else that of the only node, or the label of the process.

        A process that ran before it was observed has its own label for all nodes, also after a restart.
        """
        names = self.names_of_nodes
        if self.has_own_name or not names:
            return self.label
        if handle in names:
            return names[handle]
        return next(iter(names.values())) if len(set(names.values())) == 1 else self.label


class HandleTable(Generic[T]):
    """The things of one sort, by handle. Each process has a table of its own, which is dropped when the process
    ends."""

    def table_of(self, process: LivingProcess) -> dict[Handle, T]:
        """The table of a process."""
        table = process.tables.get(self)
        if table is None:
            table = process.tables[self] = {}
        return table


class LivingThing:
    """A publisher, subscription, timer or callback of a process, from its first hit until its pointer is reused."""

    __slots__ = ("is_replaced", "process")

    def __init__(self, process: LivingProcess) -> None:
        self.process = process
        self.is_replaced = False

    @property
    def is_alive(self) -> bool:
        return self.process.is_alive and not self.is_replaced


class _Living(Protocol):
    @property
    def is_alive(self) -> bool: ...


class Numbering:
    """Numbers things that nothing else distinguishes: no two living ones share a number.

    After a restart a thing gets its old number again; if several are free, the one whose command line is most like its
    own. If that leaves several, it gets a new number: two programs of one name must not become one.
    """

    def __init__(self) -> None:
        self._owners: dict[Hashable, list[tuple[_Living, tuple[str, ...]]]] = {}
        self._tidy_at = _TIDY_FROM

    def number(self, alike: Hashable, owner: _Living, argv: tuple[str, ...] = ()) -> int:
        """The number of a new owner, from 1; `argv` is its command line, if it is a program."""
        owners = self._owners.setdefault(alike, [])
        free = [place for place, (earlier, _) in enumerate(owners) if not earlier.is_alive]
        like = {place: _likeness(owners[place][1], argv) for place in free}
        best = [place for place in free if like[place] == max(like.values())]
        if len({owners[place][1] for place in best}) == 1:
            owners[best[0]] = owner, argv
            return best[0] + 1
        owners.append((owner, argv))
        if len(self._owners) > self._tidy_at:
            # Things that ended long ago lose their numbers.
            self._owners = {
                key: others for key, others in self._owners.items() if any(other.is_alive for other, _ in others)
            }
            self._tidy_at = max(_TIDY_FROM, 2 * len(self._owners))
        return len(owners)


def _likeness(argv: tuple[str, ...], other: tuple[str, ...]) -> tuple[bool, int]:
    """The likeness of two command lines; a launch file may give each start a file of its own."""
    return argv == other, (Counter(argv) & Counter(other)).total()


def numbered(label: str, number: int) -> str:
    """A name, with its number unless that is 1."""
    return label if number == 1 else f"{label}#{number}"


def _is_of_rclcpp(program: ObservedProgram) -> bool:
    return any(map(libraries()["librclcpp"].is_file, program.libraries))


def label_of(program: ObservedProgram) -> str:
    """The full name of the node as the command line gives it, else the name of the program or of its script.

    It is cut to NAME_CHARACTERS_MAX, because every stream keeps it, also after its program has ended.
    """
    return _told_label(program)[:NAME_CHARACTERS_MAX]


def _told_label(program: ObservedProgram) -> str:
    given: dict[str, set[str]] = {}
    for word in program.argv:
        if match := _REMAPPED.fullmatch(word):
            given.setdefault("ns" if match[1] == "ns" else "name", set()).add(match[2])
    script = script_of(program.argv) or program.name
    names, spaces = given.get("name", set()), given.get("ns", set())
    if not names and len(spaces) == 1:
        # The code usually names a node like its program.
        names = {script}
    if len(names) == 1 and len(spaces) <= 1:
        return full_name(next(iter(names)), next(iter(spaces), ""))
    return script


def full_name(name: str, namespace: str) -> str:
    """A node's name with its namespace: /robot/controller."""
    return f"/{namespace.strip('/')}/{name}".replace("//", "/")
