"""The outcome of a pair's messages, in numbers that add up, and the columns of the received ones."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rtrun.flows.messages import CALLBACK_END, INDEX, PUBLISHED, RECEIVED, MessagePair
from rtrun.flows.rows import Rows, RowStore
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.values import Int64s
from rtrun.results.columns import PIECE_ROWS, collected

_ONES = np.unpackbits(np.arange(256, dtype=np.uint8)[:, np.newaxis], axis=1).sum(axis=1, dtype=np.uint8)


@dataclass(frozen=True, kw_only=True, slots=True)
class PairCounts:
    """How many messages of a publisher came to a subscriber, and how many did not.

    published = received + lost + ambiguous + undecided. A lost message lies between the first and the last received
    one, was never received, and was overtaken longer ago than any message took to come. Undecided messages lie before
    the first and after the last received one, also around gaps and restarts: they may be on their way, or nobody may
    have been there. Ambiguous messages are counted by their publications, not by their receptions.
    """

    published: int
    received: int
    lost: int
    ambiguous: int
    undecided: int
    duplicate: int
    out_of_order: int


class DecidedMessages:
    """Which messages of a pair are known to be received or lost: a bit for each published message."""

    def __init__(self, pair: MessagePair) -> None:
        self._pair = pair
        is_decided = np.zeros(len(pair.publisher.times), np.bool_)
        for first, end in _overtaken(pair):
            is_decided[first:end] = True
        for piece in pair.rows.pieces():
            is_decided[piece[:, INDEX]] = True
        self._decided = int(np.count_nonzero(is_decided))
        self._ambiguous = 0
        for piece in pair.ambiguous.pieces():
            indices = piece[:, 0]
            self._ambiguous += int(np.count_nonzero(is_decided[indices]))
            is_decided[indices] = False
        self._bits = np.packbits(is_decided)
        del is_decided
        self._before = np.cumsum(_ONES[self._bits], dtype=np.uint32)
        self._before -= _ONES[self._bits]

    def counts(self) -> PairCounts:
        """The counts of all messages."""
        pair = self._pair
        received, ambiguous, published = len(pair.rows), len(pair.ambiguous), len(pair.publisher.times)
        out_of_order, last = 0, np.empty(0, np.int64)
        for piece in pair.rows.in_order(RECEIVED):
            indices = np.append(last, piece[:, INDEX])
            out_of_order += int(np.count_nonzero(np.diff(indices) < 0))
            last = indices[-1:]
        return PairCounts(
            published=published,
            received=received,
            lost=self._decided - received - self._ambiguous,
            ambiguous=ambiguous,
            undecided=published - self._decided - (ambiguous - self._ambiguous),
            duplicate=pair.duplicates,
            out_of_order=out_of_order,
        )

    def columns(self, store: RowStore) -> dict[str, Int64s]:
        """The columns of the pair's stream, in the order of reception; int64 of shape (received,). Raises NoRoom."""
        is_ended = any(np.any(piece[:, CALLBACK_END] != NOT_SEEN_NS) for piece in self._pair.rows.pieces())
        names = ("publication_ns", "reception_ns", "seq", "callback_end_ns")[: 3 + is_ended]
        return dict(zip(names, collected(store.folder, self._pieces(len(names)), len(names)), strict=True))

    def _pieces(self, count: int) -> Iterator[tuple[Int64s, ...]]:
        for piece in self._pair.rows.in_order(RECEIVED):
            numbers = self._number(piece[:, INDEX])
            yield (piece[:, PUBLISHED], piece[:, RECEIVED], numbers, piece[:, CALLBACK_END])[:count]

    def _number(self, indices: Int64s) -> Int64s:
        """How many messages before each publication are received or lost."""
        byte, bit = indices >> 3, indices & 7
        before_in_byte = _ONES[self._bits[byte] & (0xFF00 >> bit & 0xFF)]
        numbers: Int64s = self._before[byte].astype(np.int64) + before_in_byte
        return numbers


def _overtaken(pair: MessagePair) -> Iterator[tuple[int, int]]:
    """For each link, the index range (first, end) of the messages that are received or lost."""
    link, longest_ns = pair.link, pair.longest_ns
    for piece in pair.links.pieces():
        yield from _of_links(piece, pair.publisher.times, longest_ns)
    if link is not None:
        last = np.array([[link.first, link.last, link.until_ns]], np.int64)
        yield from _of_links(last, pair.publisher.times, longest_ns)


def _of_links(links: Int64s, sent: Rows, longest_ns: int) -> Iterator[tuple[int, int]]:
    # An overtaken message may still come for as long as any message has taken.
    before_ns = links[:, 2] - longest_ns
    fresh = np.zeros(len(links), np.int64)
    begin, end = (sent.first_after(int(at_ns)) for at_ns in (before_ns.min(), before_ns.max()))
    fresh += begin
    for start in range(begin, end, PIECE_ROWS):
        times = sent.read(start, min(start + PIECE_ROWS, end))[:, 0]
        fresh += np.searchsorted(times, before_ns, side="right")
    yield from zip(links[:, 0].tolist(), np.minimum(links[:, 1] + 1, fresh).tolist(), strict=True)
