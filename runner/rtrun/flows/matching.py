"""Which publication a received message is: by the time stamp of its source, or by its first bytes and length.

A stamp names one message. Humble and Iron take it within the publication, where no probe sees it: there the message
belongs to the publication that had begun at that time and whose thread had done nothing else since.

The same bytes may be published again. So bytes are matched only if their order decides it: as many messages were
received as were published since a moment at which none of them can have been on their way. This assumes three things.
No message is on its way for longer than the horizon. No unobserved program publishes the same bytes on a topic as an
observed one. A publisher whose last hundred messages all differed did not publish the same bytes while it was not seen.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Protocol

from rtrun.flows.messages import End, Payload, Publication, Reception
from rtrun.flows.observation_state import ObservationState
from rtrun.probes.hits import SYSTEM

# A stamp travels as a fraction of a second with 32 bits, and may come out a nanosecond or two off.
_STAMP_ROUNDING_NS = (-2, -1, 1, 2)
# How long after the begin of a publication its stamp is taken. Large messages are serialized before that, which takes a
# millisecond; on a busy machine the thread may wait for a CPU.
_WRITE_MOSTLY_NS = 10**6
_WRITE_MAX_NS = 10**8
_ALIKE_MAX = 64  #: observed messages with one time stamp: each reception is compared with all of them
# How many messages in a row have to differ from each other. At 10 Hz they are within the horizon.
_UNLIKE_MIN = 100
# Times of a realtime clock, 2014 to 2039: no part of a double that is sent in practice looks like these.
_REALTIME_S = range(1_400_000_000, 2_200_000_000)


def has_header(payload: Payload) -> bool:
    """Whether a message begins like a header: with a number, and the time at which it was made."""
    return payload[0] >> 32 in _REALTIME_S and payload[1] < 10**9


class Fates(Protocol):
    """Receives the outcomes: what became of a received message, or of a forgotten publication."""

    def matched(self, reception: Reception, publication: Publication) -> None: ...
    def ambiguous(self, reception: Reception, candidates: Sequence[Publication]) -> None: ...
    def duplicate(self, reception: Reception, publication: Publication) -> None: ...
    def historic(self, reception: Reception) -> None: ...
    def unmatched(self, reception: Reception) -> None: ...
    def forgotten(self, publication: Publication) -> None: ...


class StampMatching:
    """Messages of one topic by the time stamp that their publisher gave them.

    If no probe sees the stamp at the publication, it is the first received stamp that lies within the publication.
    """

    def __init__(self, fates: Fates, horizon_ns: int, state: ObservationState) -> None:
        self.has_unstamped = False
        """Whether publications were seen whose stamps were not."""
        self._fates = fates
        self._horizon_ns = horizon_ns
        self._state = state
        self._open: dict[int, list[Publication]] = {}
        self._oldest: deque[tuple[int, int]] = deque()
        self._unstamped: list[Publication] = []
        """What was published without a stamp, in order. Those that have got one stay: they rule out earlier ones."""

    def publish(self, key: int, publication: Publication) -> None:
        self.expire(publication.at_ns)
        if (others := self._open.get(key)) is not None:
            # With two of them, it is already unknown which one is received.
            if len(others) >= _ALIKE_MAX:
                self._fates.forgotten(publication)
                return
            others.append(publication)
        else:
            self._open[key] = [publication]
        self._oldest.append((publication.at_ns, key))

    def publish_unstamped(self, publication: Publication) -> None:
        self.expire(publication.at_ns)
        self.has_unstamped = True
        self._unstamped.append(publication)

    def _enclosing(self, key: int) -> list[Publication]:
        """The publications without a stamp to which this one may belong: the nearest, as writing takes microseconds."""
        offset_ns = self._state.offsets_ns.get(SYSTEM)
        if offset_ns is None:
            return []
        at_ns = key - offset_ns
        found: list[Publication] = []
        threads: set[int] = set()
        for place in reversed(range(bisect_right(self._unstamped, at_ns, key=attrgetter("at_ns")))):
            publication = self._unstamped[place]
            took_ns = at_ns - publication.at_ns
            if took_ns > (_WRITE_MOSTLY_NS if found else _WRITE_MAX_NS):
                break
            is_latest = publication.tid not in threads
            threads.add(publication.tid)
            until_ns = publication.until_ns
            if is_latest and not publication.has_stamp and (until_ns is None or at_ns <= until_ns):
                found.append(publication)
        return found

    def receive(self, key: int, reception: Reception) -> None:
        self.expire(reception.at_ns)
        is_open = self._open
        candidates = is_open.get(key, [])
        for step in _STAMP_ROUNDING_NS:
            if key + step in is_open:
                candidates = candidates + is_open[key + step]
        if not candidates and self._unstamped:
            candidates = self._enclosing(key)
            if len(candidates) == 1:
                candidates[0].has_stamp = True
                is_open[key] = candidates
                self._oldest.append((candidates[0].at_ns, key))
        if len(candidates) == 1:
            (publication,) = candidates
            if reception.endpoint.end in publication.takers:
                self._fates.duplicate(reception, publication)
            else:
                self._fates.matched(reception, publication)
        elif candidates:
            self._fates.ambiguous(reception, candidates)
        else:
            self._fates.unmatched(reception)

    def expire(self, now_ns: int) -> None:
        """Forget what was published longer ago than the horizon."""
        oldest, before_ns = self._oldest, now_ns - self._horizon_ns
        while oldest and oldest[0][0] < before_ns:
            for publication in self._open.pop(oldest.popleft()[1], ()):
                self._fates.forgotten(publication)
        if self._unstamped and self._unstamped[0].at_ns < before_ns:
            self._forget_unstamped(bisect_left(self._unstamped, before_ns, key=attrgetter("at_ns")))

    def _forget_unstamped(self, count: int) -> None:
        for publication in self._unstamped[:count]:
            if not publication.has_stamp:
                self._fates.forgotten(publication)
        del self._unstamped[:count]

    @property
    def open(self) -> int:
        """How many messages are remembered."""
        return len(self._oldest) + len(self._unstamped)

    def cut(self) -> None:
        """Forget everything: what comes next must not be joined with what came before."""
        for publications in self._open.values():
            for publication in publications:
                self._fates.forgotten(publication)
        self._forget_unstamped(len(self._unstamped))
        self._open.clear()
        self._oldest.clear()


class _SameBytes:
    """The publications with one payload, and by subscriber the receptions of it that are not matched yet.

    `is_early`: when the payload was first seen, a message from before the begin may have been on its way. So a match is
    `held` until the payload has not been seen for the horizon; it does not count if the publisher repeats itself. For
    all subscribers (`is_unclear`), or those in `unclear`, order decides nothing.
    """

    __slots__ = ("done", "held", "is_early", "is_unclear", "last_ns", "published", "unclear", "waiting")

    def __init__(self, is_early: bool) -> None:
        self.is_early = is_early
        self.is_unclear = False
        self.last_ns = 0
        self.published: list[Publication] = []
        self.waiting: dict[End, list[Reception]] = {}
        self.unclear: frozenset[End] = frozenset()
        self.done: dict[End, int] = {}
        """How many of the published messages a subscriber can no longer receive."""
        self.held: dict[End, tuple[Reception, Publication]] = {}


class PayloadMatching:
    """Messages of one topic by their payload; those from before the begin, or in a gap, were not seen."""

    def __init__(self, fates: Fates, horizon_ns: int, state: ObservationState) -> None:
        self._fates = fates
        self._horizon_ns = horizon_ns
        self._state = state
        self._open: dict[Payload, _SameBytes] = {}
        self._oldest: deque[tuple[int, Payload]] = deque()
        self._unlike: dict[End, int] = {}
        """For each publisher: how many messages in a row differed from all others within the horizon before them."""

    def publish(self, key: Payload, publication: Publication) -> None:
        same = self._seen(key, publication.at_ns)
        end = publication.endpoint.end
        self._unlike[end] = 0 if same.published else self._unlike.get(end, 0) + 1
        same.published.append(publication)
        if same.is_early and len(same.published) > 1:
            self._make_unclear(same)

    def receive(self, key: Payload, reception: Reception) -> None:
        same = self._seen(key, reception.at_ns)
        end = reception.endpoint.end
        candidates = len(same.published) - same.done.get(end, 0)
        begin_ns = reception.endpoint.begin_ns
        if begin_ns is not None and same.published and same.published[-1].at_ns < begin_ns:
            # The subscriber was not there yet: a publisher that latches its last message sends it to later subscribers.
            if end in same.waiting:
                self._give_up(same, end, same.waiting.pop(end))
            same.done[end] = len(same.published)
            self._fates.historic(reception)
        elif not candidates:
            # It is from an unobserved publisher, or was published before. So may be the next ones with these bytes.
            self._fates.unmatched(reception)
            self._make_unclear(same)
        elif same.is_unclear or end in same.unclear:
            self._give_up(same, end, [reception])
        elif same.is_early:
            same.done[end] = 1
            same.held[end] = (reception, same.published[0])
        elif candidates == 1 and end not in same.waiting:
            same.done[end] = len(same.published)
            self._fates.matched(reception, same.published[-1])
        else:
            waiting = same.waiting.setdefault(end, [])
            waiting.append(reception)
            if len(waiting) == candidates:
                self._resolve(same, end)

    def _seen(self, key: Payload, at_ns: int) -> _SameBytes:
        self.expire(at_ns)
        same = self._open.get(key)
        if same is None:
            same = self._open[key] = _SameBytes(self._is_early(key, at_ns))
        same.last_ns = at_ns
        self._oldest.append((at_ns, key))
        return same

    def _is_early(self, key: Payload, at_ns: int) -> bool:
        """Whether the same bytes may have been published before the begin, and be on their way."""
        begin_ns = self._state.blind_until_ns
        if at_ns >= begin_ns + self._horizon_ns:
            return False
        # Bytes that begin with the time at which they were made, or have it after a number, were not made before it.
        words = key[0] & 0xFFFFFFFF, key[0] >> 32, key[1]
        times = [second * 10**9 + nanosecond for second, nanosecond in pairwise(words) if nanosecond < 10**9]
        offsets = self._state.offsets_ns.values()
        return not any(begin_ns <= time_ns - offset_ns <= at_ns for time_ns in times for offset_ns in offsets)

    def _resolve(self, same: _SameBytes, end: End) -> None:
        """If as many were received as published, and one publisher sent them all, match them in order."""
        candidates = same.published[same.done.get(end, 0) :]
        if len({publication.endpoint for publication in candidates}) > 1:
            self._give_up(same, end, same.waiting.pop(end))
            return
        same.done[end] = len(same.published)
        for reception, publication in zip(same.waiting.pop(end), candidates, strict=True):
            self._fates.matched(reception, publication)

    def _make_unclear(self, same: _SameBytes) -> None:
        same.is_unclear = True
        for reception, publication in same.held.values():
            self._fates.ambiguous(reception, [publication])
        same.held.clear()
        for end in list(same.waiting):
            self._give_up(same, end, same.waiting.pop(end))

    def _give_up(self, same: _SameBytes, end: End, receptions: Sequence[Reception]) -> None:
        """Report as ambiguous: each of these may be any of the open publications."""
        candidates = same.published[same.done.get(end, 0) :]
        same.unclear |= {end}
        same.done[end] = len(same.published)
        for number, reception in enumerate(receptions):
            self._fates.ambiguous(reception, () if number else candidates)

    def expire(self, now_ns: int) -> None:
        """Forget what was published longer ago than the horizon.

        An unclear payload stays unclear until it has not been seen for that long.
        """
        oldest, before_ns = self._oldest, now_ns - self._horizon_ns
        while oldest and oldest[0][0] < before_ns:
            _, key = oldest.popleft()
            same = self._open.get(key)
            if same is None:
                continue
            if same.last_ns < before_ns:
                del self._open[key]
                self._settle(same)
            elif same.published and same.published[0].at_ns < before_ns:
                self._drop_first(same)

    def _drop_first(self, same: _SameBytes) -> None:
        for end in [*same.waiting]:
            if not same.done.get(end, 0):
                self._give_up(same, end, same.waiting.pop(end))
        publication = same.published.pop(0)
        for end, (reception, matched) in list(same.held.items()):
            if matched is publication:
                del same.held[end]
                self._decide(reception, publication)
        same.done = {end: max(0, done - 1) for end, done in same.done.items()}
        self._fates.forgotten(publication)

    def _settle(self, same: _SameBytes) -> None:
        """Decide what can be decided about a payload that no longer occurs."""
        for reception, publication in same.held.values():
            self._decide(reception, publication)
        for end in [*same.waiting]:
            self._give_up(same, end, same.waiting.pop(end))
        for publication in same.published:
            self._fates.forgotten(publication)

    def _decide(self, reception: Reception, publication: Publication) -> None:
        """Decide a match that was held: an earlier message may have come instead, and this one may be lost."""
        if self._unlike.get(publication.endpoint.end, 0) >= _UNLIKE_MIN:
            self._fates.matched(reception, publication)
        else:
            self._fates.ambiguous(reception, [publication])

    @property
    def open(self) -> int:
        """How many messages are remembered, at either end."""
        return len(self._oldest)

    def cut(self) -> None:
        """Forget everything: what comes next must not be joined with what came before."""
        for same in self._open.values():
            # Whether the held messages would have come again is unknown.
            self._make_unclear(same)
            self._settle(same)
        self._open.clear()
        self._oldest.clear()
