"""Reader of the gnuplot logs that the suites write, today's and those of 2014.

A log is a histogram in bins of 1 us below a summary in comments. It is untrusted. A file is refused with
``file:line: what is wrong`` when it is not such a log, is cut off, or contradicts itself (counts that do not add up to
the number in the summary, or another minimum, mean or maximum than the summary). Known errors in logs of 2014 are
corrected; `Log.remarks` lists each correction.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.figures import LISTED, IndexedValue
from rtrun.kinds.known import LOGS
from rtrun.kinds.limits import COUNT_MAX
from rtrun.kinds.values import Int64s
from rtrun.plan.suites import LogFacts, Value, read_log_name
from rtrun.results.gnuplot_lines import COUNTS, Printed, Text, read_text

TOLERANCE_US = 1  # between a printed number, however it was rounded, and the bins
MEAN_TOLERANCE_US = 2  # larger, because the mean itself is rounded too
# Logs count from the arming of the timer, as in 2014.
SENTINEL_US = -1  # marked a missing message in 2014


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Log:
    """A log as read: its bins that are not empty, ascending; `value_us` and `count` have shape (bins,).

    `series` is measured_2014, reported, difference_2014, jitter or latency. `parameters` come from the log's name; they
    are empty if the name is foreign. `printed` is None when the log has no measurement.
    """

    path: Path
    suite: str
    series: str
    parameters: dict[str, Value]
    value_us: Int64s
    count: Int64s
    printed: Printed | None
    top: tuple[IndexedValue, ...]
    lowest: tuple[IndexedValue, ...]
    missing: int
    out_of_order: int
    duplicate: int
    not_fired: int
    incomplete: str | None
    remarks: tuple[str, ...]


def read_log(path: Path) -> Log:
    """Read one log. Raises UsageError ``file:line: what is wrong``."""
    return _interpret(path, read_text(path))


def _interpret(path: Path, text: Text) -> Log:
    if not text.suite:
        raise UsageError(f"{path}:{text.lines}: no log of a suite: the summary is none of {', '.join(LOGS)}")
    name = read_log_name(path.name) or read_log_name(f"{Path(text.output).name}.log")
    if name and name.suite != text.suite:
        raise UsageError(f"{path}: named as a log of {name.suite}, but its summary is one of {text.suite}")
    series = _series(text.suite, name)
    value_us, count = _bins(path, text)
    _check_summaries(path, text, series, value_us, count)
    number = {key: text.counts.get(key, (0, 0))[0] for key in COUNTS}
    total, (asked, asked_line) = int(count.sum()), text.counts["asked"]
    remarks: list[str] = []
    lists = {key: _without_padding(entries) for key, entries in text.lists.items()}
    if padding := sum(len(entries) - len(lists[key]) for key, entries in text.lists.items()):
        remarks.append(f"{padding} entries that pad the lists of top and lowest values, as in 2014, are left out")
    is_missing = value_us == SENTINEL_US
    sentinels = int(count[is_missing].sum()) if LOGS[text.suite].missing_as_value else 0
    # In 2014 a missing message was stored among the values, and a timer that did not fire was repeated, so the bins
    # hold as many values as were asked for. The missing messages were reported only if no value was lower than their
    # marker.
    if total == asked and sentinels and number["missing"]:
        if number["missing"] != sentinels:
            line = text.counts["missing"][1]
            raise UsageError(f"{path}:{line}: {number['missing']} missing messages, but {sentinels} in the bin of -1")
        value_us, count = value_us[~is_missing], count[~is_missing]
        lists = {key: tuple(e for e in entries if e.value_ns != SENTINEL_US * 1000) for key, entries in lists.items()}
        remarks.append(
            f"{sentinels} missing messages stand in the log as -1 us, as in 2014: its MIN, AVG and lowest values are"
            " wrong; the figures here are without them"
        )
    elif total == asked and number["not_fired"]:
        remarks.append("timers that did not fire were repeated, as in 2014")
    elif total != (text.incomplete[0] if text.incomplete else asked - number["missing"] - number["not_fired"]):
        raise UsageError(
            f"{path}:{asked_line}: the summary speaks of {asked} measurements, {number['missing']} missing,"
            f" {number['not_fired']} not fired, but the bins hold {total}"
        )
    if sentinels and bool((value_us < SENTINEL_US).any()):
        remarks.append(f"if this log is of 2014, {sentinels} of its values, those of -1 us, are missing messages")
    if series in ("reported", "difference_2014"):
        lists = {}  # these logs list the measured values
    top = _of_these_bins("top", lists.get("top", ()), value_us[::-1], count[::-1], remarks)
    lowest = _of_these_bins("lowest", lists.get("lowest", ()), value_us, count, remarks)
    return Log(
        path=path,
        suite=text.suite,
        series=series,
        parameters=name.parameters if name else {},
        value_us=value_us,
        count=count,
        printed=text.summaries.get(series, text.summaries.get("xlabel")),
        top=top,
        lowest=lowest,
        incomplete=text.incomplete[1] if text.incomplete else None,
        remarks=tuple(remarks),
        **number,
    )


def _series(suite: str, name: LogFacts | None) -> str:
    known = LOGS[suite].series
    return known.get(name.log if name else "", next(iter(known.values())))


def _bins(path: Path, text: Text) -> tuple[Int64s, Int64s]:
    """Values, ascending, and counts of the bins."""
    value_us, count = np.array(text.values, dtype=np.int64), np.array(text.numbers, dtype=np.int64)
    order = np.argsort(value_us)
    value_us, count = value_us[order], count[order]
    if (twice := value_us[1:][np.diff(value_us) == 0]).size:
        raise UsageError(f"{path}:{text.lines}: the bin of {twice[0]} stands twice")
    if float(count.sum(dtype=np.float64)) > COUNT_MAX:
        raise UsageError(f"{path}:{text.lines}: more than {COUNT_MAX} measurements")
    return value_us, count


def _check_summaries(path: Path, text: Text, series: str, value_us: Int64s, count: Int64s) -> None:
    """Refuse a log whose summary does not match its bins."""
    if not count.size:
        return
    summaries = [text.summaries[key] for key in ("xlabel", series) if key in text.summaries]
    if not summaries:
        raise UsageError(f"{path}:{text.lines}: no summary with MIN, AVG and MAX of the bins")
    mean = float(np.dot(value_us.astype(np.float64), count)) / int(count.sum())
    for printed in summaries:
        for name, printed_us, computed_us, tolerance in (
            ("MIN", printed.min_us, float(value_us[0]), TOLERANCE_US),
            ("MAX", printed.max_us, float(value_us[-1]), TOLERANCE_US),
            ("AVG", printed.avg_us, mean, MEAN_TOLERANCE_US),
        ):
            if abs(printed_us - computed_us) > tolerance:
                raise UsageError(
                    f"{path}:{printed.line}: the summary's {name} is {printed_us:.0f} us, "
                    f"that of the bins {computed_us:.0f} us"
                )


def _without_padding(entries: tuple[IndexedValue, ...]) -> tuple[IndexedValue, ...]:
    """The list without entries whose index occurred in it before.

    In 2014 a list that was not full was padded with the opposite bound and index 0. If index 0 is nowhere else in the
    list, its value is that bound: every value beyond the bound would have found a place.
    """
    first = {entry.index: entry for entry in reversed(entries)}
    return tuple(entry for entry in entries if first[entry.index] is entry)


def _of_these_bins(
    which: str, entries: tuple[IndexedValue, ...], value_us: Int64s, count: Int64s, remarks: list[str]
) -> tuple[IndexedValue, ...]:
    """The list with the values of the bins, if it matches their order; an empty list, and a remark, otherwise."""
    values = np.repeat(value_us[:LISTED], np.minimum(count[:LISTED], LISTED))[: len(entries)] * 1000
    if len(values) == len(entries) and all(
        abs(entry.value_ns - int(value)) <= TOLERANCE_US * 1000 for entry, value in zip(entries, values, strict=True)
    ):
        return tuple(
            IndexedValue(value_ns=int(value), index=entry.index) for entry, value in zip(entries, values, strict=True)
        )
    remarks.append(f"the list of {which} values does not belong to the bins: its indices are left out")
    return ()
