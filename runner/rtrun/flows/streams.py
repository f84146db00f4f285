"""The streams of an observation: what the accumulator has, with names that outlast a restart and columns to keep."""

from collections.abc import Iterator
from dataclasses import replace

from rtfiles.output import printable
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed import callback, interval, messages, path, timer
from rtrun.flows.observed.source import ObservedKind, StreamSource
from rtrun.flows.values import Stream
from rtrun.kinds.kind import StreamKind
from rtrun.results.columns import NoRoom

OBSERVED: tuple[ObservedKind, ...] = (messages, timer, callback, interval, path)


def streams(observed: FlowAccumulator) -> Iterator[Stream]:
    """One value for each thing that was measured, in the order in which they were first seen.

    All of them together may be more than the memory holds. One that there was no room to read has its trouble instead.
    """
    seen: dict[tuple[object, ...], int] = {}
    for kind in OBSERVED:
        for source in kind.sources(observed):
            stream = _printable(_read(kind.STREAM, source))
            # Names that differ in bytes that cannot be printed only are alike when printed.
            key = (stream.kind, *stream.identity.items())
            seen[key] = seen.get(key, 0) + 1
            yield stream if seen[key] == 1 else replace(stream, identity={**stream.identity, "alike": seen[key]})


def _read(kind: StreamKind, source: StreamSource) -> Stream:
    try:
        return source.stream()
    except NoRoom as error:
        return Stream(kind=kind, identity=source.identity, columns={}, counts={}, trouble=str(error))


def _printable(stream: Stream) -> Stream:
    identity = {key: printable(value) if isinstance(value, str) else value for key, value in stream.identity.items()}
    return replace(stream, identity=identity)
