"""Paths of topics: the time from a message on a path's first topic to the message on its last topic that follows from
it."""

from collections.abc import Sequence

from rtrun.flows.messages import End, Publication, Reception
from rtrun.flows.rows import RowStore

_Hop = tuple[int, int]
"""The place of a path among the paths, and the place of a topic on the path."""


class PathLog:
    """The begin and end of each message of a publisher at the end of a path. `unknown` ones have no known begin."""

    __slots__ = ("rows", "unknown")

    def __init__(self, store: RowStore) -> None:
        self.rows = store.rows(2)
        self.unknown = 0


class PathRecord:
    """Follows messages along the paths that were asked for, each of two topics at least."""

    def __init__(self, paths: Sequence[Sequence[str]], store: RowStore) -> None:
        self._store = store
        self.paths = tuple(tuple(path) for path in paths)
        self.logs: dict[tuple[int, End], PathLog] = {}
        self._hops: dict[str, list[_Hop]] = {}
        for number, path in enumerate(self.paths):
            for place, topic in enumerate(path):
                self._hops.setdefault(topic, []).append((number, place))

    def published(self, publication: Publication, handled: Reception | None) -> None:
        """A message was published, within the callback of the received message `handled`; None if that is not known."""
        for number, place in self._hops.get(publication.endpoint.topic, ()):
            begin_ns = publication.at_ns if place == 0 else None
            if place and handled is not None and handled.publication is not None:
                begin_ns = handled.publication.begins.get((number, place - 1))
            if begin_ns is not None:
                publication.begins[number, place] = begin_ns
            if place == len(self.paths[number]) - 1:
                key = number, publication.endpoint.end
                log = self.logs.get(key)
                if log is None:
                    log = self.logs[key] = PathLog(self._store)
                if begin_ns is None:
                    log.unknown += 1
                else:
                    log.rows.add((begin_ns, publication.at_ns))
