"""The kernel's own events as they came, in few bytes each, because the values of most are never needed."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.kinds.values import Int64s, no_values
from rtrun.probes.formats import EventFormat, RawValues
from rtrun.probes.hits import Hit

EventKind = tuple[str, EventFormat]
"""The name, as sched/sched_switch, and how its values are read."""
_Some = slice | NDArray[np.bool_] | Int64s
_NUMBERS = {1: ("<i1", "<u1"), 2: ("<i2", "<u2"), 4: ("<i4", "<u4"), 8: ("<i8", "<u8")}
"""The types of numbers by their bytes, with a sign and without; those above 2**63 - 1 become negative."""
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

    def numbers(self, some: Int64s, name: str) -> Int64s:
        """A number in some of the events, which are all of one kind; int64 (n,).

        Raises ValueError if the kernel's events of that kind have no such number.
        """
        if not some.size:
            return no_values()
        rows = self.rows[some]
        event, form = self.kinds[int(rows["kind"][0])]
        field = next((field for field in form.fields if field.name == name and field.size in _NUMBERS), None)
        if field is None:
            raise ValueError(f"the kernel's event {event} has no number {name}")
        if int(rows["size"].min()) < field.offset + field.size:
            raise ValueError(f"an event {event} that ends before its field {name}")
        begins = rows["end"].astype(np.int64) - rows["size"] + field.offset
        data = np.frombuffer(self.data, np.uint8)[begins[:, None] + np.arange(field.size)]
        numbers: Int64s = data.view(_NUMBERS[field.size][field.code.isupper()]).reshape(-1).astype(np.int64)
        return numbers

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
