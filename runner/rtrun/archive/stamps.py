"""The order in which the files of an archive were written: by the stamps in their names, not by clocks alone.

A stamp looks like a time in UTC, such as 20261124T101500Z. A writer first lists the existing files, then takes the time
of its clock or the second after the latest stamp, whichever is later. So a file comes after all files that its writer
saw, even within one second, on a machine whose clock is slow, and after a clock was set back. Only files that were
written at the same moment, without seeing each other, may have the same stamp.
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
    """The time of a stamp, in UTC; None where the text is not a stamp."""
    if not _STAMP.fullmatch(text):
        return None
    try:
        return datetime.strptime(text, _FORM).replace(tzinfo=UTC)
    except ValueError:  # for example month 13
        return None


def next_stamp(stamps: Iterable[str], now: datetime) -> str:
    """The stamp for a file that is written now (UTC) next to files with these stamps.

    Texts that are not stamps are ignored. Raises UsageError where no later stamp can be written.
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
