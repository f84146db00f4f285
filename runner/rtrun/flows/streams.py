"""The streams of an observation: the accumulator's records, with names that stay the same after a restart, and
columns."""

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from typing import cast

from rtfiles.output import printable
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import ObservedKind, StreamSource
from rtrun.flows.values import Stream
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.known import STREAMS
from rtrun.results.columns import NoRoom

# Each kind that probes see has a module by its word.
OBSERVED = tuple(
    cast("ObservedKind", import_module(f"rtrun.flows.observed.{word.replace('-', '_')}"))
    for word, kind in STREAMS.items()
    if not kind.is_of_topologies
)


def streams(observed: FlowAccumulator) -> Iterator[Stream]:
    """Yield a stream for each measured thing, in the order in which they were first seen.

    All streams together may be larger than the memory. A stream without room to be read has `trouble` instead.
    """
    seen: dict[tuple[object, ...], int] = {}
    for kind in OBSERVED:
        for source in kind.sources(observed):
            stream = _printable(_read(kind.STREAM, source))
            # Names that differ only in unprintable bytes look alike when printed.
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
