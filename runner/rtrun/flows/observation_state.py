"""The state of an observation that every reader of hits needs."""

from collections.abc import Mapping

from rtrun.flows.programs import Handle, LivingProcess, LivingThing, Numbering, numbered
from rtrun.flows.rows import RowStore
from rtrun.probes.hits import HITS_CLOCK

FAULT = "(fault)"
"""The kernel's word for a text that it could not read."""


# Limits for measured streams, and for living things: processes, threads, publishers, subscriptions, timers, callbacks,
# names. A large robot has some thousand of each.
STREAMS_MAX = 10_000  #: streams of an observation
THINGS_MAX = 50_000  #: living processes, threads, publishers, subscriptions, timers, callbacks, names
LABELS_MAX = 50_000  #: pairs of a label of an observation and a pid, those of ended processes included


class ObservationState:
    """The state of an observation. `epoch` counts the gaps: things seen in two epochs must not be joined."""

    def __init__(self, begin_ns: int, store: RowStore) -> None:
        self.epoch = 0
        self.store = store
        """The rows of everything that is measured."""
        self.blind_until_ns = begin_ns
        """The end of the last gap, or the begin."""
        self.numbering = Numbering()
        self.pids: dict[str, set[int]] = {}
        """The pids of the processes that had a label."""
        self.offsets_ns = {HITS_CLOCK: 0}
        """How far each clock was ahead of the hits' clock at its last reading."""
        self.unreadable = 0
        """Hits that lack values that they should have."""
        self.left_out = 0
        """Hits of streams or things that had no room."""
        self._streams = self._things = self._pids = 0

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another stream."""
        return self._streams >= STREAMS_MAX

    def add_stream(self) -> bool:
        """Reserve room for another stream; False if there is none."""
        if self.is_full:
            self.left_out += 1
            return False
        self._streams += 1
        return True

    def add_thing(self) -> bool:
        """Reserve room for another living thing; False if there is none."""
        if self._things >= THINGS_MAX:
            self.left_out += 1
            return False
        self._things += 1
        return True

    def has_room(self, handle: Handle, known: Mapping[Handle, object]) -> bool:
        """Whether a thing is known by its handle, or room could be reserved for it."""
        return handle in known or self.add_thing()

    def drop_things(self, number: int) -> None:
        """Free the room of this many things, which have ended."""
        self._things -= number

    def add_pid(self, label: str, pid: int) -> None:
        """A process had a label."""
        if self._pids < LABELS_MAX and pid not in self.pids.get(label, ()):
            self.pids.setdefault(label, set()).add(pid)
            self._pids += 1

    def cut(self, until_ns: int) -> None:
        """Hits are missing until a time."""
        self.epoch += 1
        self.blind_until_ns = max(until_ns, self.blind_until_ns)

    def label(self, process: LivingProcess, name: str) -> str:
        """The name of a node, the same for all topics of its process; numbered if another living process has it."""
        label = process.labels.get(name)
        if label is None:
            argv = process.program.argv if process.program is not None else ()
            label = process.labels[name] = numbered(name, self.numbering.number(("process", name), process, argv))
        self.add_pid(label, process.pid)
        return label

    def label_of(self, thing: LivingThing, node: Handle | None, alike: tuple[str, str]) -> str:
        """The label of a thing's node, with a number if others of its process are `alike` by their kind and name."""
        label = self.label(thing.process, thing.process.node(node))
        number = self.numbering.number((*alike, label), thing)
        if number > 1:
            label = f"{label} ({number})"
            self.add_pid(label, thing.process.pid)
        return label
