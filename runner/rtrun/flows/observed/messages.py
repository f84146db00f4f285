"""The messages of a publisher that a subscriber took, and those that it did not take."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from rtfiles.output import counted
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.decided import DecidedMessages
from rtrun.flows.messages import PUBLISHED, RECEIVED, MessagePair
from rtrun.flows.observed.source import Growth, Identity, is_seen, stalled_ns, without_values
from rtrun.flows.values import Stream
from rtrun.kinds.messages import STREAM as STREAM
from rtrun.kinds.values import no_values


def sources(observed: FlowAccumulator) -> Iterator["MessageSource"]:
    return (MessageSource(pair, observed) for pair in observed.topics.pairs.values())


@dataclass(frozen=True, slots=True)
class MessageSource:
    record: MessagePair
    observed: FlowAccumulator

    @property
    def name(self) -> str:
        return self.record.publisher.topic

    @property
    def detail(self) -> str:
        return f"{self.record.publisher.label} to {self.record.subscriber.label}"

    @property
    def identity(self) -> Identity:
        publisher, subscriber = self.record.publisher, self.record.subscriber
        return {"topic": publisher.topic, "publisher": publisher.label, "subscriber": subscriber.label}

    def stream(self) -> Stream:
        copies = self.record.copies
        if copies:
            return without_values(STREAM, self, copies)
        decided = DecidedMessages(self.record)
        counts = decided.counts()
        remarks: tuple[str, ...] = ()
        if counts.ambiguous:
            unknown = f"not known of {counted(counts.ambiguous, 'publication')} whether they came"
            told_apart_by = self.observed.topics.told_apart_by(self.record.publisher.topic)
            remarks = (f"{unknown}: other messages have the same {told_apart_by}",)
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns=decided.columns(self.observed.state.store),
            counts=asdict(counts),
            remarks=remarks,
            open_ns=self._untaken_ns(),
            source=self.record,
        )

    def since(self, row: int) -> Growth:
        if self.record.copies:
            return Growth(0, no_values(), no_values(), 0)
        new = self.record.rows.read(row)
        times, rows = new[:, RECEIVED], len(self.record.rows)
        return Growth(rows, times - new[:, PUBLISHED], times, rows, self.record.lost_so_far)

    def _untaken_ns(self) -> int:
        """The age of the oldest message that the subscriber has not taken; 0 if it is not overdue."""
        pair, observed = self.record, self.observed
        publisher, subscriber = pair.publisher, pair.subscriber
        link = pair.link
        if link is None or not (is_seen(publisher, observed) and is_seen(subscriber, observed)):
            return 0
        # The publisher has not restarted since the link began, and since then the subscriber took no message at all.
        is_same = publisher.cuts[-1] <= link.first and subscriber.times[-1] <= link.until_ns
        unclear = max((int(piece.max()) for piece in pair.ambiguous.pieces()), default=-1)
        if not is_same or not unclear <= link.last < len(publisher.times) - 1:
            return 0
        return stalled_ns(publisher.times[link.last + 1], pair.longest_ns, observed)
