"""Messages of every pair of publisher and subscriber: published, received and lost ones, in numbers that add up."""

from collections.abc import Sequence

from rtfiles.output import counted
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import HandleTable, LivingProcess, LivingThing
from rtrun.flows.rows import RowStore
from rtrun.kinds.messages import NOT_SEEN_NS

Payload = tuple[int, int, int]
"""What tells messages of roscpp apart: the first eight bytes, the next four, and the length."""


class Copies:
    """Messages that a subscriber took from its own process, and whose callback was not seen to begin.

    With intra-process communication rclcpp passes the message to the callback by pointer, which no probe sees. If a
    program outside subscribes, too, the middleware brings a copy, which rclcpp takes and discards.
    """

    __slots__ = ("_number", "_process")

    def __init__(self) -> None:
        self._number = 0
        self._process: LivingProcess | None = None

    def add(self, process: LivingProcess) -> None:
        self._number += 1
        self._process = process

    def __len__(self) -> int:
        return self._number if self._process is not None and self._process.passes_pointers else 0

    def __str__(self) -> str:
        taken = counted(len(self), "message")
        return f"no values: rclcpp passes messages on by pointer, which no probe sees, and {taken} taken may be copies"


class End:
    """One end of a topic, over all restarts of its program: a publisher, or a subscriber.

    Each message that a subscriber takes is either received, a duplicate, ambiguous, historic (published before the
    subscriber was there), unmatched, or not decided yet. `forgotten` counts publications that no subscriber was seen to
    take.

    A publisher of a lifecycle node pauses while the node is not active: since `paused_ns`, None if it does not;
    `pauses` counts the pauses.
    """

    __slots__ = (
        "ambiguous", "copies", "cuts", "duplicates", "forgotten", "historic", "label", "latest", "paused_ns", "pauses",
        "received", "times", "topic", "unmatched",
    )  # fmt: skip

    def __init__(self, topic: str, label: str, store: RowStore) -> None:
        self.topic = topic
        self.label = label
        self.times = store.rows()
        self.cuts = store.rows()
        self.latest: tuple[int, Endpoint] | None = None
        self.copies = Copies()
        self.paused_ns: int | None = None
        self.pauses = 0
        self.received = self.duplicates = self.ambiguous = self.historic = self.unmatched = self.forgotten = 0

    def add(self, at_ns: int, endpoint: "Endpoint", epoch: int) -> int:
        """Count a message at this end; returns its index."""
        index = len(self.times)
        latest = self.latest
        if latest is None or latest[1] is not endpoint or latest[0] != epoch or self.paused_ns is not None:
            self.cuts.add((index,))
            self.latest, self.paused_ns = (epoch, endpoint), None
        self.times.add((at_ns,))
        return index

    def pause(self, at_ns: int) -> None:
        """A node of its process has been deactivated."""
        if len(self.times):
            self.paused_ns = at_ns
            self.pauses += 1

    def resume(self) -> None:
        """The latest message is the first one after a pause."""
        index = len(self.times) - 1
        if self.cuts[-1] != index:
            self.cuts.add((index,))


class Endpoint(LivingThing):
    """A publisher or subscription of a living process."""

    __slots__ = ("begin_ns", "end", "topic")

    def __init__(self, process: LivingProcess, topic: str, begin_ns: int | None) -> None:
        super().__init__(process)
        self.topic = topic
        self.begin_ns = begin_ns
        """When it was made, if that was seen."""
        self.end: End


PUBLISHERS, SUBSCRIBERS = HandleTable[Endpoint](), HandleTable[Endpoint]()
SUBSCRIPTIONS = HandleTable[Endpoint]()
"""By their handles in rcl, and by their objects in rclcpp."""


class Publication:
    """One call of publish. `begins`: when each path to which it belongs began, by path and place.

    `until_ns` is when its thread did something else; None: that is not known. `has_stamp`: its time stamp is known.
    `resumes`: it is the first one after a pause.
    """

    __slots__ = ("at_ns", "begins", "cpu", "endpoint", "has_stamp", "index", "resumes", "takers", "tid", "until_ns")

    def __init__(self, endpoint: Endpoint, index: int, at_ns: int, tid: int, cpu: int) -> None:
        self.endpoint = endpoint
        self.index = index
        self.at_ns = at_ns
        self.tid = tid
        self.cpu = cpu
        self.takers: tuple[End, ...] = ()
        self.begins: dict[tuple[int, int], int] = {}
        self.until_ns: int | None = None
        self.has_stamp = self.resumes = False


class Reception:
    """One message that a subscriber took; `publication` is set once known, `end_ns` once its callback has ended."""

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

    @property
    def is_own(self) -> bool:
        """Whether it may come from its own process, and thus be a copy of a message that this passes by pointer."""
        return self.publication is None or self.publication.endpoint.process is self.endpoint.process

    def is_left(self) -> None:
        """Its thread did something else instead of calling back for it."""
        process = self.endpoint.process
        if self.is_own and process.shows_callbacks:
            self.endpoint.end.copies.add(process)
            if self.pair is not None:
                self.pair.copies.add(process)

    def ended(self, at_ns: int) -> None:
        """Its callback has ended; if there are several, the last one counts."""
        self.end_ns = at_ns
        if self.pair is not None:
            self.pair.rows.put(self.row, CALLBACK_END, at_ns)


# The takers of all remembered publications. One reception may belong to any of thousands of equal publications.
TAKERS_MAX = 400_000  #: takers, sure or possible, of all observed messages that are remembered
# The columns of the rows of a pair.
PUBLISHED, RECEIVED, CALLBACK_END, INDEX = range(4)


class LinkedTime:
    """The messages of a pair in a period without a gap and without a restart.

    `first` and `last` are the lowest and the highest index received, `until_ns` is the time of the latest reception.
    """

    __slots__ = ("epoch", "first", "last", "publisher", "subscriber", "until_ns")

    def __init__(self, publisher: Endpoint, subscriber: Endpoint, epoch: int, index: int) -> None:
        self.publisher = publisher
        self.subscriber = subscriber
        self.epoch = epoch
        self.first = self.last = index
        self.until_ns = 0

    def is_of(self, publisher: Endpoint, subscriber: Endpoint, epoch: int) -> bool:
        """Whether a message between these endpoints, in this epoch, belongs to it."""
        return self.publisher is publisher and self.subscriber is subscriber and self.epoch == epoch


class MessagePair:
    """The messages of a publisher that a subscriber took, over all restarts of both.

    `rows` are the received messages, by the columns above. `links` has first, last and `until_ns` of each period before
    that of `link`.
    """

    __slots__ = ("_linked", "ambiguous", "copies", "duplicates", "link", "links", "publisher", "rows", "subscriber")

    def __init__(self, publisher: End, subscriber: End, store: RowStore) -> None:
        self.publisher = publisher
        self.subscriber = subscriber
        self.link: LinkedTime | None = None
        self.links = store.rows(3)
        self.rows = store.rows(4)
        self.ambiguous = store.rows()
        """Indices of publications that may have been received, each once."""
        self.copies = Copies()
        self.duplicates = 0
        self._linked = 0

    def add(self, reception: Reception, publication: Publication, epoch: int) -> None:
        """A message was received."""
        index, link = publication.index, self.link
        if link is None or not link.is_of(publication.endpoint, reception.endpoint, epoch):
            if link is not None:
                self.links.add((link.first, link.last, link.until_ns))
                self._linked += link.last - link.first + 1
            link = self.link = LinkedTime(publication.endpoint, reception.endpoint, epoch, index)
        if index < link.first:
            link.first = index
        elif index > link.last:
            link.last = index
        if reception.at_ns > link.until_ns:
            link.until_ns = reception.at_ns
        reception.pair = self
        reception.row = len(self.rows)
        self.rows.add((publication.at_ns, reception.at_ns, reception.end_ns, index))

    @property
    def longest_ns(self) -> int:
        """The longest time that a message took; 0 if none came."""
        return max((int((piece[:, RECEIVED] - piece[:, PUBLISHED]).max()) for piece in self.rows.pieces()), default=0)

    @property
    def lost_so_far(self) -> int:
        """A quick estimate of how many are lost."""
        decided = self._linked + (self.link.last - self.link.first + 1 if self.link else 0)
        return max(0, decided - len(self.rows) - len(self.ambiguous))


class MessageRecord:
    """The pairs of an observation. The matching reports to it what became of each message."""

    def __init__(self, state: ObservationState) -> None:
        self._state = state
        self.pairs: dict[tuple[End, End], MessagePair] = {}
        self.takers = 0
        """The takers of all remembered publications."""
        self._links_epoch = 0

    @property
    def has_too_many_takers(self) -> bool:
        """Whether publications have to be forgotten."""
        return self.takers > TAKERS_MAX

    def matched(self, reception: Reception, publication: Publication) -> None:
        subscriber, publisher = reception.endpoint, publication.endpoint
        if subscriber.begin_ns is not None and publication.at_ns < subscriber.begin_ns:
            self.historic(reception)
            return
        pair = self._pair(publisher.end, subscriber.end)
        if pair is None:
            return
        self._add_taker(publication, subscriber.end)
        reception.publication = publication
        subscriber.end.received += 1
        if publication.resumes:
            subscriber.end.resume()
        pair.add(reception, publication, self._links_epoch)

    def _add_taker(self, publication: Publication, taker: End) -> None:
        publication.takers += (taker,)
        self.takers += 1

    def ambiguous(self, reception: Reception, candidates: Sequence[Publication]) -> None:
        end = reception.endpoint.end
        end.ambiguous += 1
        for publication in candidates:
            if end not in publication.takers:
                self._add_taker(publication, end)
                if (pair := self._pair(publication.endpoint.end, end)) is not None:
                    pair.ambiguous.add((publication.index,))

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
        self.takers -= len(publication.takers)

    def unlink(self) -> None:
        """Hits are missing: from here on messages are counted anew, from the next one on."""
        self._links_epoch += 1

    def _pair(self, publisher: End, subscriber: End) -> MessagePair | None:
        pair = self.pairs.get((publisher, subscriber))
        if pair is None and self._state.add_stream():
            pair = self.pairs[publisher, subscriber] = MessagePair(publisher, subscriber, self._state.store)
        return pair
