"""Whether the counts of an output add up, among themselves and with its logs."""

from collections.abc import Iterable

from rtrun.kinds.output import Record
from rtrun.results.gnuplot_log import Log

LISTED_MAX = 1000  # The suites list so many indices of each kind at most.


def find_count_mismatch(record: Record, logs: Iterable[Log] = ()) -> str | None:
    """Say what does not add up in a record and the logs beside it, or None when all of it does.

    What was asked for was measured, did not fire, or is missing; of an incomplete record there may be less (never more,
    as `read_samples` has it).
    A message that came twice was received once, and counts as duplicate apart.
    """
    counts = record.counts
    if record.complete and counts.known != counts.asked:
        return f"{counts.asked} asked for, but {counts.known} measured + not fired + missing"
    for kind, indices in record.indices:
        count = getattr(counts, kind)
        if len(indices) != min(count, LISTED_MAX):
            return f"{count} {kind.replace('_', ' ')}, but {len(indices)} indices of them"
        if any(index >= counts.asked for index in indices):
            return f"an index {kind.replace('_', ' ')} lies outside 0 to {counts.asked - 1}"
    for log in logs:
        if (n := int(log.count.sum())) != counts.measured:
            return f"{counts.measured} measured, but {n} in the log {log.path.name}"
    return None
