"""In which hours of the day runs were measured: nights do not show that a machine is worse by day."""

from collections.abc import Iterable
from datetime import datetime, timedelta

from rtrun.analysis.account import HOURS
from rtrun.results.record import RunRecord, moment


def hours_measured(records: Iterable[RunRecord]) -> int | None:
    """In how many of the 24 hours of a day (UTC) runs were measured; None if the time of one is not known."""
    hours: set[int] = set()
    for record in records:
        start, end = moment(record.start_time), moment(record.end_time)
        if start is None:
            return None
        hours |= _hours(start, end or start)
    return len(hours) or None


def _hours(start: datetime, end: datetime) -> set[int]:
    if end - start >= timedelta(days=1):
        return set(range(HOURS))
    first = start.replace(minute=0, second=0, microsecond=0)
    spanned = int(max(timedelta(0), end - first) / timedelta(hours=1))
    return {(first.hour + hour) % HOURS for hour in range(spanned + 1)}
