"""What all that reads hits needs to know of the observation so far."""

from rtrun.flows.programs import LivingProcess, Numbering, numbered

HITS_CLOCK = "steady"
"""The clock of the hits, CLOCK_MONOTONIC. How another one lies to it has to be told.

``system`` is CLOCK_REALTIME, ``raw`` is CLOCK_MONOTONIC_RAW.
"""
FAULT = "(fault)"
"""The kernel's word for a text that it could not read."""


class Situation:
    """Where an observation stands. `epoch` counts the gaps: what was seen in two epochs may not be joined."""

    def __init__(self, begin_ns: int) -> None:
        self.epoch = 0
        self.blind_until_ns = begin_ns
        """The end of the last gap, or the begin."""
        self.numbering = Numbering()
        self.pids: dict[str, set[int]] = {}
        """Of the processes that had a label."""
        self.offsets_ns = {HITS_CLOCK: 0}
        """How far each clock was ahead of that of the hits when it was last read."""
        self.unreadable = 0
        """Hits without what they should tell."""

    def cut(self, until_ns: int) -> None:
        """Hits are missing until a time."""
        self.epoch += 1
        self.blind_until_ns = max(until_ns, self.blind_until_ns)

    def label(self, process: LivingProcess, name: str) -> str:
        """The name of a node, the same for all topics of its process; numbered where another living one has it."""
        label = process.labels.get(name)
        if label is None:
            label = process.labels[name] = numbered(name, self.numbering.number(("process", name), process))
        self.pids.setdefault(label, set()).add(process.pid)
        return label
