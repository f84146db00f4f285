"""Messages of every pair of publisher and subscriber: what was published, received and lost, in numbers that add up."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtrun.analysis.histogram import Int64s
from rtrun.flows.programs import LivingProcess, LivingThing
from rtrun.flows.situation import Situation
from rtrun.flows.values import int64s
from rtrun.kinds.messages import NOT_SEEN_NS

Payload = tuple[int, int, int]
"""What tells messages of roscpp from one another: the first eight bytes, the next four, and the length."""


class End:
    """One end of a topic, over all restarts of its program: a publisher, or a subscriber.

    Of what a subscriber takes each is either received, a duplicate, ambiguous, historic (published before the
    subscriber was there), unmatched, or not decided yet. `forgotten` publications nobody was seen to take.
    """

    __slots__ = (
        "ambiguous", "cuts", "duplicates", "forgotten", "historic", "label", "latest", "received", "times", "topic",
        "unmatched",
    )  # fmt: skip

    def __init__(self, topic: str, label: str) -> None:
        self.topic = topic
        self.label = label
        self.times: array[int] = array("q")
        self.cuts: array[int] = array("q")
        self.latest: tuple[int, Endpoint] | None = None
        self.received = self.duplicates = self.ambiguous = self.historic = self.unmatched = self.forgotten = 0

    def add(self, at_ns: int, endpoint: "Endpoint", epoch: int) -> int:
        """Count a message at this end; returns its index."""
        index = len(self.times)
        latest = self.latest
        if latest is None or latest[1] is not endpoint or latest[0] != epoch:
            self.cuts.append(index)
            self.latest = (epoch, endpoint)
        self.times.append(at_ns)
        return index


class Endpoint(LivingThing):
    """A publisher or subscription of a living process."""

    __slots__ = ("begin_ns", "end", "links", "topic")

    def __init__(self, process: LivingProcess, topic: str, begin_ns: int | None) -> None:
        super().__init__(process)
        self.topic = topic
        self.begin_ns = begin_ns
        """When it was made, where that was seen."""
        self.end: End
        self.links: dict[Endpoint, LinkedTime] = {}


class Publication:
    """One call of publish. `begins` are the times at which the paths began that it is on, by path and place."""

    __slots__ = ("at_ns", "begins", "cpu", "endpoint", "index", "takers", "tid")

    def __init__(self, endpoint: Endpoint, index: int, at_ns: int, tid: int, cpu: int) -> None:
        self.endpoint = endpoint
        self.index = index
        self.at_ns = at_ns
        self.tid = tid
        self.cpu = cpu
        self.takers: tuple[End, ...] = ()
        self.begins: dict[tuple[int, int], int] = {}


class Reception:
    """One message that a subscriber took; `publication` once it is known, `end_ns` when its callback has ended."""

    __slots__ = ("at_ns", "cpu", "end_ns", "endpoint", "pair", "publication", "row", "tid")

    def __init__(self, endpoint: Endpoint, at_ns: int, tid: int, cpu: int) -> None:
        self.endpoint = endpoint
        self.at_ns = at_ns
        self.tid = tid
        self.cpu = cpu
        self.end_ns = NOT_SEEN_NS
        self.publication: Publication | None = None
        self.pair: MessagePair | None = None
        self.row = 0

    def ended(self, at_ns: int) -> None:
        """Its callback has ended; of several the last one counts."""
        self.end_ns = at_ns
        if self.pair is not None:
            self.pair.callback_ends[self.row] = at_ns


class LinkedTime:
    """The messages of a pair in a time without a gap and without a restart.

    `first` and `last` are the lowest and highest index that was received, `until_ns` when the latest one was.
    """

    __slots__ = ("first", "last", "pair", "until_ns")

    def __init__(self, pair: "MessagePair", index: int) -> None:
        self.pair = pair
        self.first = self.last = index
        self.until_ns = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class PairCounts:
    """What became of the messages of a publisher at a subscriber.

    published = received + lost + ambiguous + undecided. Lost are those between the first and the last received one that
    were never received, and were overtaken longer ago than any took to come. Undecided are those before the first and
    after the last, and so before and after gaps and restarts: they may be on their way, or nobody was there. Each that
    was ambiguous is here by its publication, not by its reception.
    """

    published: int
    received: int
    lost: int
    ambiguous: int
    undecided: int
    duplicate: int
    out_of_order: int


class MessagePair:
    """The messages of a publisher that a subscriber took, over all restarts of both."""

    __slots__ = (
        "ambiguous", "callback_ends", "duplicates", "indices", "links", "publications", "publisher", "receptions",
        "subscriber",
    )  # fmt: skip

    def __init__(self, publisher: End, subscriber: End) -> None:
        self.publisher = publisher
        self.subscriber = subscriber
        self.links: list[LinkedTime] = []
        self.publications: array[int] = array("q")
        self.receptions: array[int] = array("q")
        self.callback_ends: array[int] = array("q")
        self.indices: array[int] = array("q")
        self.ambiguous: array[int] = array("q")
        """Indices of publications that may have been received, each once."""
        self.duplicates = 0

    def add(self, link: LinkedTime, reception: Reception, publication: Publication) -> None:
        """A message was received."""
        index = publication.index
        if index < link.first:
            link.first = index
        elif index > link.last:
            link.last = index
        if reception.at_ns > link.until_ns:
            link.until_ns = reception.at_ns
        reception.pair = self
        reception.row = len(self.indices)
        self.indices.append(index)
        self.publications.append(publication.at_ns)
        self.receptions.append(reception.at_ns)
        self.callback_ends.append(reception.end_ns)

    def _spans(self) -> tuple[Int64s, Int64s]:
        """First and last index of the times in which every message is received, lost or ambiguous; disjoint."""
        received, sent_ns = np.sort(int64s(self.indices)), int64s(self.publisher.times)
        longest_ns = int((int64s(self.receptions) - int64s(self.publications)).max(initial=0))
        found: list[tuple[int, int]] = []
        for link in self.links:
            # One that was overtaken may still come for as long as any has taken.
            fresh = int(np.searchsorted(sent_ns, link.until_ns - longest_ns, side="right"))
            if link.first < fresh:
                found.append((link.first, min(link.last, fresh - 1)))
            begin, end = np.searchsorted(received, [max(fresh, link.first), link.last + 1])
            found += [(index, index) for index in received[begin:end].tolist()]
        spans: list[list[int]] = []
        for first, last in sorted(found):
            if spans and first <= spans[-1][1] + 1:
                spans[-1][1] = max(last, spans[-1][1])
            else:
                spans.append([first, last])
        firsts, lasts = np.array(spans, np.int64).reshape(-1, 2).T
        return firsts, lasts

    def _order(self) -> Int64s:
        """Rows by the time of reception: what was decided later stands at its place."""
        return np.argsort(int64s(self.receptions), kind="stable")

    @property
    def lost_so_far(self) -> int:
        """About how many are lost, found quickly."""
        decided = sum(link.last - link.first + 1 for link in self.links)
        return max(0, decided - len(self.indices) - len(self.ambiguous))

    def counts(self) -> PairCounts:
        firsts, lasts = self._spans()
        indices = int64s(self.indices)[self._order()]
        unclear = np.sort(int64s(self.ambiguous))
        inside = unclear.size - self._outside(unclear, firsts, lasts).size
        decided = int((lasts - firsts + 1).sum())
        published = len(self.publisher.times)
        return PairCounts(
            published=published,
            received=indices.size,
            lost=decided - indices.size - inside,
            ambiguous=len(self.ambiguous),
            undecided=published - decided - (len(self.ambiguous) - inside),
            duplicate=self.duplicates,
            out_of_order=int(np.count_nonzero(np.diff(indices) < 0)),
        )

    def columns(self) -> dict[str, Int64s]:
        """The columns of its stream; int64 of shape (received,)."""
        order = self._order()
        indices, ends = int64s(self.indices)[order], int64s(self.callback_ends)[order]
        firsts, lasts = self._spans()
        place = np.searchsorted(firsts, indices, side="right") - 1
        before = np.concatenate(([0], np.cumsum(lasts - firsts + 1)))[place]
        unclear = np.sort(int64s(self.ambiguous))
        outside = self._outside(unclear, firsts, lasts)
        counted = np.searchsorted(unclear, indices) - np.searchsorted(outside, indices)
        made = {
            "publication_ns": int64s(self.publications)[order],
            "reception_ns": int64s(self.receptions)[order],
            "seq": before + indices - firsts[place] - counted,
        }
        return made | {"callback_end_ns": ends} if np.any(ends != NOT_SEEN_NS) else made

    @staticmethod
    def _outside(indices: Int64s, firsts: Int64s, lasts: Int64s) -> Int64s:
        if not firsts.size:
            return indices
        place = np.searchsorted(firsts, indices, side="right") - 1
        return indices[(place < 0) | (indices > lasts[place])]


class MessageRecord:
    """The pairs of an observation, told by the matching what became of each message."""

    def __init__(self, situation: Situation) -> None:
        self._situation = situation
        self.pairs: dict[tuple[End, End], MessagePair] = {}
        self._linked: list[Endpoint] = []

    def matched(self, reception: Reception, publication: Publication) -> None:
        subscriber, publisher = reception.endpoint, publication.endpoint
        if subscriber.begin_ns is not None and publication.at_ns < subscriber.begin_ns:
            self.historic(reception)
            return
        link = subscriber.links.get(publisher)
        if link is None:
            link = self._link(subscriber, publisher, publication.index)
            if link is None:
                return
        publication.takers += (subscriber.end,)
        reception.publication = publication
        subscriber.end.received += 1
        link.pair.add(link, reception, publication)

    def ambiguous(self, reception: Reception, candidates: Sequence[Publication]) -> None:
        end = reception.endpoint.end
        end.ambiguous += 1
        for publication in candidates:
            if end not in publication.takers:
                publication.takers += (end,)
                if (pair := self._pair(publication.endpoint.end, end)) is not None:
                    pair.ambiguous.append(publication.index)

    def duplicate(self, reception: Reception, publication: Publication) -> None:
        reception.endpoint.end.duplicates += 1
        if (pair := self._pair(publication.endpoint.end, reception.endpoint.end)) is not None:
            pair.duplicates += 1

    def historic(self, reception: Reception) -> None:
        reception.endpoint.end.historic += 1

    def unmatched(self, reception: Reception) -> None:
        reception.endpoint.end.unmatched += 1

    def forgotten(self, publication: Publication) -> None:
        if not publication.takers:
            publication.endpoint.end.forgotten += 1

    def unlink(self) -> None:
        """Hits are missing: what comes next is counted from its own first message on."""
        for endpoint in self._linked:
            endpoint.links.clear()
        self._linked.clear()

    def _pair(self, publisher: End, subscriber: End) -> MessagePair | None:
        pair = self.pairs.get((publisher, subscriber))
        if pair is None and self._situation.add_stream():
            pair = self.pairs[publisher, subscriber] = MessagePair(publisher, subscriber)
        return pair

    def _link(self, subscriber: Endpoint, publisher: Endpoint, index: int) -> LinkedTime | None:
        pair = self._pair(publisher.end, subscriber.end)
        if pair is None:
            return None
        link = subscriber.links[publisher] = LinkedTime(pair, index)
        pair.links.append(link)
        self._linked.append(subscriber)
        return link
