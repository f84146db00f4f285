"""Outliers as a trace that ui.perfetto.dev opens: slices on tracks, in Perfetto's protobuf format.

It is encoded by hand, because it needs only a dozen fields of protos/perfetto/trace/: `Trace.packet`, `TracePacket`,
`TrackDescriptor` and `TrackEvent`. A test reads it with the classes that Perfetto publishes.
"""

from collections.abc import Iterable, Iterator

from rtfiles.output import printable
from rtfiles.quantities import time
from rtrun.causes.events import Context
from rtrun.causes.outliers import Explained

# Field numbers, by message.
_TRACE_PACKET = 1
_PACKET_TIMESTAMP, _PACKET_SEQUENCE, _PACKET_EVENT, _PACKET_TRACK = 8, 10, 11, 60
_TRACK_UUID, _TRACK_NAME, _TRACK_PARENT = 1, 2, 5
_EVENT_TYPE, _EVENT_TRACK, _EVENT_NAME = 9, 11, 23
_SLICE_BEGIN, _SLICE_END = 1, 2
_SEQUENCE = 1

Slice = tuple[int, int, str]
"""Begin and end in nanoseconds, and the name."""


def perfetto(explained: Iterable[Explained]) -> bytes:
    """The trace: for each run a track with its measured values, one with their parts, and one per CPU."""
    tracks: dict[str, dict[str, list[Slice]]] = {}
    for case in explained:
        outlier = case.outlier
        of_run = tracks.setdefault(f"{outlier.run} {outlier.output}", {})
        name = f"index {outlier.index}: {time(outlier.value_ns)} late"
        of_run.setdefault("measured values", []).append((outlier.due_ns, outlier.at_ns, name))
        for part in case.parts:
            words = f"{part.cause.kind} {part.cause.name}".strip()
            of_run.setdefault("what they waited for", []).append((part.begin_ns, part.end_ns, words))
        for cpu, spans in case.around.items():
            on_cpu = of_run.setdefault(f"CPU {cpu}", [])
            for span in spans:
                if (who := span.occupant) is not None:
                    name = f"{who.name} {who.pid}" if who.context is Context.THREAD else f"{who.context} {who.name}"
                    on_cpu.append((span.begin_ns, span.end_ns, name))
    return b"".join(_packets(tracks))


def _packets(tracks: dict[str, dict[str, list[Slice]]]) -> Iterator[bytes]:
    uuid = 0
    for group, of_run in tracks.items():
        uuid += 1
        parent = uuid
        yield _track(parent, group)
        for name, slices in sorted(of_run.items(), key=lambda item: (item[0].startswith("CPU"), item[0])):
            uuid += 1
            yield _track(uuid, name, parent)
            end_ns = 0
            for begin_ns, finish_ns, about in sorted(slices):
                # Outliers close to each other show the same moments: each moment is drawn once.
                begin_ns = max(begin_ns, end_ns)
                if begin_ns < finish_ns:
                    end_ns = finish_ns
                    yield _event(begin_ns, _SLICE_BEGIN, uuid, about)
                    yield _event(finish_ns, _SLICE_END, uuid)


def _track(uuid: int, name: str, parent: int | None = None) -> bytes:
    track = _number(_TRACK_UUID, uuid) + _text(_TRACK_NAME, name)
    if parent is not None:
        track += _number(_TRACK_PARENT, parent)
    return _bytes(_TRACE_PACKET, _number(_PACKET_SEQUENCE, _SEQUENCE) + _bytes(_PACKET_TRACK, track))


def _event(at_ns: int, kind: int, track: int, name: str | None = None) -> bytes:
    event = _number(_EVENT_TYPE, kind) + _number(_EVENT_TRACK, track)
    if name is not None:
        event += _text(_EVENT_NAME, name)
    packet = _number(_PACKET_TIMESTAMP, at_ns) + _number(_PACKET_SEQUENCE, _SEQUENCE) + _bytes(_PACKET_EVENT, event)
    return _bytes(_TRACE_PACKET, packet)


# The encoding: protobuf.dev/programming-guides/encoding.


def _varint(number: int) -> bytes:
    digits = bytearray()
    while number > 127:
        digits.append(number & 127 | 128)
        number >>= 7
    digits.append(number)
    return bytes(digits)


def _number(field: int, number: int) -> bytes:
    return _varint(field << 3) + _varint(number)


def _bytes(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _text(field: int, text: str) -> bytes:
    return _bytes(field, printable(text).encode("utf-8", errors="replace"))
