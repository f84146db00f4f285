"""In which order the files of an archive were written: by the stamps in their names, never by a clock alone.

A stamp looks like a time in UTC, as 20261124T101500Z. A writer lists what is there first, and takes its clock's time or
the second after the latest stamp, whichever is later. So what was written with another file in sight comes after it,
within one second, on a machine whose clock is slow, and after a clock was put back. Only files that were written at the
same moment, neither in sight of the other, may have the same stamp.
"""

import re
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

from rtfiles.errors import UsageError

_FORM = "%Y%m%dT%H%M%SZ"
_STAMP = re.compile(r"[0-9]{8}T[0-9]{6}Z", re.ASCII)
_TICK = timedelta(seconds=1)


def as_stamp(moment: datetime) -> str:
    """A time in UTC as a stamp."""
    return moment.strftime(_FORM)


def read_stamp(text: str) -> datetime | None:
    """The time of a stamp, in UTC; None where the text is no stamp."""
    if not _STAMP.fullmatch(text):
        return None
    try:
        return datetime.strptime(text, _FORM).replace(tzinfo=UTC)
    except ValueError:  # the month 13
        return None


def next_stamp(stamps: Iterable[str], now: datetime) -> str:
    """The stamp of a file that is written now, in UTC, where there are files of these stamps.

    Texts that are no stamps do not count. Raises UsageError where no later stamp can be written.
    """
    known = [moment for text in stamps if (moment := read_stamp(text)) is not None]
    clock = now.replace(tzinfo=UTC)
    if not known:
        return as_stamp(clock)
    try:
        return as_stamp(max(clock, max(known) + _TICK))
    except OverflowError as error:
        last = as_stamp(max(known))
        raise UsageError(f"a file is named {last}: no name can be later; remove or rename it") from error
