"""The kernel's own events as they came, in few bytes each: nobody ever asks for the values of most of them."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.kinds.values import Int64s
from rtrun.probes.formats import EventFormat, RawValues
from rtrun.probes.hits import Hit

EventKind = tuple[str, EventFormat]
"""The name, as sched/sched_switch, and how its values are read."""
_Some = slice | NDArray[np.bool_] | Int64s
_ROW = np.dtype([(name, np.uint32) for name in ("cpu", "pid", "tid", "kind", "end", "size")])


@dataclass(frozen=True, slots=True, eq=False)
class KernelEvents:
    """Events in the order of time; iteration makes each of them a Hit.

    `at_ns`, int64 (n,), is of CLOCK_MONOTONIC. `rows` has the other fields of each event, `data` has its bytes.
    """

    at_ns: Int64s
    rows: NDArray[np.void]
    data: bytearray
    kinds: Sequence[EventKind]

    def __len__(self) -> int:
        return len(self.at_ns)

    def __iter__(self) -> Iterator[Hit]:
        for at_ns, row in zip(self.at_ns, self.rows, strict=True):
            cpu, pid, tid, kind, end, size = row.tolist()
            event, form = self.kinds[kind]
            # The hit gets a copy of its own bytes only: it may be kept.
            yield Hit(int(at_ns), cpu, pid, tid, event, RawValues(form, bytes(self.data[end - size : end]), 0, size))

    @property
    def size_bytes(self) -> int:
        """About how much memory they take."""
        return self.at_ns.nbytes + self.rows.nbytes + len(self.data)

    def only(self, some: _Some) -> "KernelEvents":
        """Some of them."""
        return KernelEvents(self.at_ns[some], self.rows[some], self.data, self.kinds)

    def between(self, from_ns: int, until_ns: int) -> "KernelEvents":
        """The events from one time to before another."""
        first, last = np.searchsorted(self.at_ns, [from_ns, until_ns])
        return self.only(slice(first, last))


class WaitingEvents:
    """Events that wait for the end of their round, as they came."""

    def __init__(self, kinds: Sequence[EventKind]) -> None:
        self._kinds = kinds
        self._at_ns: array[int] = array("q")
        self._rows: array[int] = array("I")
        self._data = bytearray()

    def __len__(self) -> int:
        return len(self._at_ns)

    def add(self, at_ns: int, cpu: int, pid: int, tid: int, kind: int, data: bytes) -> None:
        """Add an event; `kind` is the number of its kind."""
        self._data += data
        self._rows.extend((cpu, pid, tid, kind, len(self._data), len(data)))
        self._at_ns.append(at_ns)

    def cut(self, until_ns: int, silent: Sequence[tuple[int, int]]) -> KernelEvents:
        """Take the events up to a time, and drop those of silent times; later events keep waiting."""
        came = KernelEvents(
            np.frombuffer(self._at_ns, np.int64), np.frombuffer(self._rows, _ROW), self._data, self._kinds
        )
        self._at_ns, self._rows, self._data = array("q"), array("I"), bytearray()
        events = came.only(np.argsort(came.at_ns, kind="stable"))
        for from_ns, before_ns in silent:
            first, last = np.searchsorted(events.at_ns, [from_ns, before_ns])
            if last > first:
                events = events.only(np.delete(np.arange(len(events)), slice(first, last)))
        count = int(np.searchsorted(events.at_ns, until_ns, side="right"))
        later = events.only(slice(count, None))
        for at_ns, row in zip(later.at_ns.tolist(), later.rows, strict=True):
            cpu, pid, tid, kind, end, size = row.tolist()
            self.add(at_ns, cpu, pid, tid, kind, bytes(came.data[end - size : end]))
        return events.only(slice(None, count))
