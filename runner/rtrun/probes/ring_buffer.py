"""Pages of the kernel's ring buffer, as per_cpu/cpu*/trace_pipe_raw gives them: events with their times.

Source: include/linux/ring_buffer.h and kernel/trace/ring_buffer.c. A page has the time of its first event, the length
of its content, and events: 5 bits hold their kind or length, 27 bits the time since the event before. Only
little-endian machines are supported. Pages come from a target: whatever they contain, only ValueError is raised.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from rtrun.kinds.limits import TIME_MAX_NS
from rtrun.probes.formats import subbuffer_bytes

_MISSED = 1 << 31
_MISSED_COUNTED = 1 << 30
_LENGTH = (1 << 27) - 1
_DATA_MAX, _PADDING, _TIME_EXTEND, _TIME_STAMP = 28, 29, 30, 31
_DELTA_BITS, _DELTA_SHIFT = 27, 5
# Events have the lower 59 bits of an absolute time.
_STAMP_UPPER = 0x1F << 59
# Since the boot: 28 years. Times of an observation that then lasts for some years still fit the record.
_CLOCK_MAX_NS = TIME_MAX_NS // 10 * 9
_WORD = struct.Struct("<I")
_HEAD = {4: struct.Struct("<QI"), 8: struct.Struct("<QQ")}


@dataclass(frozen=True, slots=True)
class PageLayout:
    """How pages are made on a target."""

    size_bytes: int
    commit_bytes: int
    data_offset: int

    @classmethod
    def read(cls, header_page: str) -> "PageLayout":
        """Read the layout from the file events/header_page. Raises ValueError."""
        return cls(*subbuffer_bytes(header_page))


@dataclass(frozen=True, slots=True)
class Page:
    """The head of a page: when the page begins, and whether and how many events before it were lost (None: unknown)."""

    begin_ns: int
    has_lost: bool
    lost: int | None
    length: int


def read_head(page: bytes, layout: PageLayout) -> Page:
    """Read the head of a page. Raises ValueError."""
    if len(page) != layout.size_bytes:
        raise ValueError(f"a page of {len(page)} bytes in place of {layout.size_bytes}")
    begin_ns, whole = _HEAD[layout.commit_bytes].unpack_from(page)
    # The kernel adds the upper bits as numbers with a sign.
    commit, upper = whole & 0xFFFFFFFF, whole >> 32
    length = commit & _LENGTH
    end = layout.data_offset + length
    if upper not in (0, 0xFFFFFFFF) or end > layout.size_bytes or begin_ns >= _CLOCK_MAX_NS:
        raise ValueError(f"a page that claims {length} bytes of events from {begin_ns} ns on")
    lost = None
    if commit & _MISSED_COUNTED:
        if end + layout.commit_bytes > layout.size_bytes:
            raise ValueError("a page whose count of lost events is beyond its end")
        lost = int.from_bytes(page[end : end + layout.commit_bytes], "little")
    return Page(begin_ns, bool(commit & _MISSED), lost, length)


def read_events(page: bytes, layout: PageLayout, head: Page) -> Iterator[tuple[int, int, int]]:
    """Yield time in nanoseconds, place and size of each event's data in a page. Raises ValueError."""
    at_ns, place = head.begin_ns, layout.data_offset
    end = place + head.length
    word_at = _WORD.unpack_from
    while place + 4 <= end:
        (word,) = word_at(page, place)
        kind, delta_ns = word & 31, word >> _DELTA_SHIFT
        if 0 < kind <= _DATA_MAX:
            start, size = place + 4, kind * 4
            at_ns += delta_ns
        else:
            if kind == _PADDING and not delta_ns:
                return
            if place + 8 > end:
                raise ValueError("a page whose last event is beyond its end")
            (further,) = word_at(page, place + 4)
            if kind == 0:
                start, size = place + 8, further - 4
                at_ns += delta_ns
            elif kind == _PADDING:
                # An event that was discarded.
                if further < 4:
                    raise ValueError("a page with an event of no length")
                place += 4 + further
                continue
            else:
                stamp_ns = (further << _DELTA_BITS) + delta_ns
                at_ns = (at_ns & _STAMP_UPPER) | stamp_ns if kind == _TIME_STAMP else at_ns + stamp_ns
                place += 8
                continue
        if size < 4 or start + size > end or at_ns >= _CLOCK_MAX_NS:
            raise ValueError(f"a page with an event of {size} bytes at {place} and {at_ns} ns, where it has {end}")
        yield at_ns, start, size
        place = start + size
        # Every event begins at a multiple of four.
        place += -place % 4
