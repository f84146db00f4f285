"""Reader of the gnuplot logs that the suites write, today's and those of 2014.

A log is a histogram in bins of 1 us below a summary in comments. It is untrusted: a file that is not such a log, is cut
off, or contradicts itself (counts that do not add up to the summary's number, another minimum, mean or maximum than the
summary's) is refused with ``file:line: what is wrong``. What a log of 2014 is known to get wrong is put right, and each
correction is told in `Log.remarks`.
"""

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np

from rtfiles.errors import UsageError
from rtrun.figures import LISTED, Figures, Int64s, Ranked, figures_of_bins
from rtrun.suites import LogName, Value, read_log_name

MAX_SIZE_BYTES = 128 << 20  # 8 million lines: values up to 8 s
MAX_LINE_BYTES = 1 << 20
MAX_VALUE_US = 10**15 - 1  # 31 years
MAX_TOTAL = 10**12  # measurements in one log
TOLERANCE_US = 1  # between a printed number, however it was rounded, and the bins
MEAN_TOLERANCE_US = 2  # as the mean's own rounding comes on top
SENTINEL_US = -1  # what stood for a missing message in 2014

_BIN = re.compile(r"(#?)(-?[0-9]{1,15})[ \t]+([0-9]{1,12})[ \t]*", re.ASCII)
_NUMBER = r"(-?[0-9]{1,15}(?:\.[0-9]{1,6})?)"
_BOUNDS = re.compile(rf"MIN:\s*{_NUMBER}us\s+AVG:\s*{_NUMBER}us\s+MAX:\s*{_NUMBER}us")
_ENTRY = re.compile(rf"{_NUMBER}:([0-9]{{1,12}})")
_LABELS = {"Measured:": "measured", "Reported:": "reported", "Difference:": "difference", "Jitter:": "jitter"}
_LISTS = {"Indices of top values": "top", "Indices of lowest values": "lowest"}
_SUITES = {
    "oneshot_timer_tests": re.compile(r"with a loop length of ([0-9]{1,12}) "),
    "cyclic_timer_tests": re.compile(r"with a total of ([0-9]{1,12}) measurements"),
    "communication_tests": re.compile(r"Amount messages: ([0-9]{1,12})\b"),
}
_INCOMPLETE = re.compile(r"Incomplete: ([0-9]{1,12}) of [0-9]{1,12} measured, (.*)")
_COUNTS = {
    "out_of_order": re.compile(r"Messages out of order: ([0-9]{1,12})\b"),
    "missing": re.compile(r"Total of ([0-9]{1,12}) missing messages"),
    "duplicate": re.compile(r"Total of ([0-9]{1,12}) duplicate messages"),
    "not_fired": re.compile(r"^([0-9]{1,12}) timers didn't fire"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Printed:
    """A summary as it stands in the log, in microseconds, uncorrected; `line` is where."""

    min_us: float
    avg_us: float
    max_us: float
    line: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Log:
    """A log as read: the bins that hold something, rising, `value_us` and `count` of shape (bins,).

    `series` is measured, reported, difference, jitter or latency. `parameters` are those that the log's name tells,
    none if the name is foreign. `printed` is None when the log has no measurement.
    """

    path: Path
    suite: str
    series: str
    parameters: dict[str, Value]
    value_us: Int64s
    count: Int64s
    printed: Printed | None
    top: tuple[Ranked, ...]
    lowest: tuple[Ranked, ...]
    missing: int
    out_of_order: int
    duplicate: int
    not_fired: int
    remarks: tuple[str, ...]

    def figures(self) -> Figures:
        """Figures of the bins."""
        return figures_of_bins(
            self.value_us,
            self.count,
            top=self.top,
            lowest=self.lowest,
            missing=self.missing,
            out_of_order=self.out_of_order,
            duplicate=self.duplicate,
            not_fired=self.not_fired,
        )


def read_log(path: Path) -> Log:
    """Read one log. Raises UsageError ``file:line: what is wrong``."""
    try:
        with path.open("rb") as stream:
            stream.seek(0, 2)
            if stream.tell() > MAX_SIZE_BYTES:
                raise UsageError(f"{path}: {stream.tell()} bytes, a log has at most {MAX_SIZE_BYTES}")
            stream.seek(0)
            text = _read(path, stream)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    return _interpret(path, text)


@dataclass(kw_only=True, slots=True)
class _Text:
    """What stands in the lines, not yet interpreted. `counts` hold (number, line)."""

    suite: str = ""
    output: str = ""
    incomplete: tuple[int, str] | None = None  # how many were measured, and why no more
    summaries: dict[str, Printed] = field(default_factory=dict)  # by series, "" for one without a label
    counts: dict[str, tuple[int, int]] = field(default_factory=dict)
    lists: dict[str, tuple[Ranked, ...]] = field(default_factory=dict)
    values: "array[int]" = field(default_factory=lambda: array("q"))
    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    last: dict[str, int] = field(default_factory=dict)  # the last bin, by "" and "#"
    lines: int = 0


class _Lines:
    """The lines of a file, with the number of the last one read."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.stream, self.number = path, stream, 0

    def __iter__(self) -> Iterator[str]:
        while raw := self.stream.readline(MAX_LINE_BYTES):
            self.number += 1
            if len(raw) == MAX_LINE_BYTES:
                self.refuse("the line is longer than any in a log")
            yield raw.decode("utf-8", "replace").rstrip("\r\n")

    def refuse(self, message: str) -> NoReturn:
        raise UsageError(f"{self.path}:{self.number}: {message}")


def _read(path: Path, stream: BinaryIO) -> _Text:
    lines, text = _Lines(path, stream), _Text()
    numbered = iter(lines)
    for line in numbered:
        if line == "# Plot data for gnuplot":
            break
        if not line.startswith(("set ", "plot ")):
            lines.refuse(f"no log of a suite: 'set ...' or 'plot ...' must stand here, not {_cut(line)}")
        _read_command(lines, text, line)
    else:
        lines.refuse("no log of a suite: '# Plot data for gnuplot' is missing")
    for line in numbered:
        if line == "end":
            break
        if line.startswith("# "):
            _read_comment(lines, text, line[2:])
        elif line:
            _read_bin(lines, text, line)
    else:
        lines.refuse("cut off: the last line must be 'end'")
    for line in numbered:
        if line:
            lines.refuse(f"nothing may follow 'end', got {_cut(line)}")
    text.lines = lines.number
    return text


def _cut(line: str) -> str:
    return repr(line if len(line) <= 40 else line[:40] + "...")


def _read_command(lines: _Lines, text: _Text, line: str) -> None:
    if line.startswith("set xlabel ") and (found := _BOUNDS.search(line)):
        text.summaries["xlabel"] = _printed(found, lines.number)
    elif found := re.fullmatch(r'set output "(.*)\.jpg"', line):
        text.output = found[1]


def _printed(found: re.Match[str], line: int) -> Printed:
    return Printed(min_us=float(found[1]), avg_us=float(found[2]), max_us=float(found[3]), line=line)


def _read_comment(lines: _Lines, text: _Text, line: str) -> None:
    if found := _BOUNDS.search(line):
        label = line[: found.start()].strip()
        text.summaries[_LABELS.get(label, "latency")] = _printed(found, lines.number)
    for suite, pattern in _SUITES.items():
        if found := pattern.search(line):
            text.suite = suite
            text.counts["asked"] = (int(found[1]), lines.number)
    for name, pattern in _COUNTS.items():
        if found := pattern.search(line):
            text.counts[name] = (int(found[1]), lines.number)
    if found := _INCOMPLETE.fullmatch(line):
        text.incomplete = (int(found[1]), found[2])
    for mark, name in _LISTS.items():
        if line.startswith(mark):
            # The first piece is the explanation in front of the first bar.
            entries = [_ENTRY.fullmatch(piece) for piece in line.split("|")]
            text.lists[name] = tuple(Ranked(value_us=float(e[1]), index=int(e[2])) for e in entries if e)


def _read_bin(lines: _Lines, text: _Text, line: str) -> None:
    found = _BIN.fullmatch(line)
    if not found:
        lines.refuse(f"a bin must stand here, 'value <TAB>count', not {_cut(line)}")
    value, number = int(found[2]), int(found[3])
    if found[1] and value >= 0:
        lines.refuse(f"only a negative value is commented out, not {_cut(line)}")
    if value <= text.last.get(found[1], -MAX_VALUE_US - 1):
        lines.refuse(f"the bins must rise, {value} follows {text.last[found[1]]}")
    text.last[found[1]] = value
    if number:
        text.values.append(value)
        text.numbers.append(number)


def _interpret(path: Path, text: _Text) -> Log:
    if not text.suite:
        raise UsageError(f"{path}:{text.lines}: no log of a suite: the summary is none of {', '.join(_SUITES)}")
    name = read_log_name(path.name) or read_log_name(f"{Path(text.output).name}.log")
    if name and name.suite != text.suite:
        raise UsageError(f"{path}: named as a log of {name.suite}, but its summary is one of {text.suite}")
    series = _series(text.suite, name)
    value_us, count = _bins(path, text)
    _check_summaries(path, text, series, value_us, count)
    number = {key: text.counts.get(key, (0, 0))[0] for key in _COUNTS}
    total, (asked, asked_line) = int(count.sum()), text.counts["asked"]
    remarks: list[str] = []
    lists = {key: _without_padding(entries) for key, entries in text.lists.items()}
    if padding := sum(len(entries) - len(lists[key]) for key, entries in text.lists.items()):
        remarks.append(f"{padding} entries that pad the lists of top and lowest values, as in 2014, are left out")
    # In 2014 a missing message stood among the values, and a timer that did not fire was repeated: the bins then hold
    # as many as were asked for. The missing messages were told only if no value was below theirs.
    sentinels = int(count[value_us == SENTINEL_US].sum()) if text.suite == "communication_tests" else 0
    if total == asked and sentinels and number["missing"]:
        if number["missing"] != sentinels:
            line = text.counts["missing"][1]
            raise UsageError(f"{path}:{line}: {number['missing']} missing messages, but {sentinels} in the bin of -1")
        count, value_us = count[value_us != SENTINEL_US], value_us[value_us != SENTINEL_US]
        lists = {key: tuple(e for e in entries if e.value_us != SENTINEL_US) for key, entries in lists.items()}
        remarks.append(
            f"{sentinels} missing messages stand in the log as -1 us, as in 2014: its MIN, AVG and lowest values are"
            " wrong; the figures here are without them"
        )
    elif total == asked and number["not_fired"]:
        remarks.append(f"{number['not_fired']} timers did not fire and were repeated, as in 2014: no figure shows them")
    elif text.incomplete:
        remarks.append(f"incomplete: {text.incomplete[1]}")
    if sentinels and value_us[0] < SENTINEL_US:
        remarks.append(f"if this log is of 2014, {sentinels} of its values, those of -1 us, are missing messages")
    expected = {asked, asked - number["missing"] - number["not_fired"]}
    if text.incomplete:
        expected = {text.incomplete[0]}
    if total not in expected:
        raise UsageError(
            f"{path}:{asked_line}: the summary speaks of {asked} measurements, {number['missing']} missing,"
            f" {number['not_fired']} not fired, but the bins hold {total}"
        )
    if series in ("reported", "difference"):
        lists = {}  # these logs print the lists of the measured values
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
        remarks=tuple(remarks),
        **number,
    )


def _series(suite: str, name: LogName | None) -> str:
    if suite == "oneshot_timer_tests":
        log = name.log if name else "measured"
        return "difference" if log == "diff" else log
    return "jitter" if suite == "cyclic_timer_tests" else "latency"


def _bins(path: Path, text: _Text) -> tuple[Int64s, Int64s]:
    """Values, rising, and counts of the bins."""
    value_us, count = np.array(text.values, dtype=np.int64), np.array(text.numbers, dtype=np.int64)
    order = np.argsort(value_us)
    value_us, count = value_us[order], count[order]
    if (twice := value_us[1:][np.diff(value_us) == 0]).size:
        raise UsageError(f"{path}:{text.lines}: the bin of {twice[0]} stands twice")
    if float(count.sum(dtype=np.float64)) > MAX_TOTAL:
        raise UsageError(f"{path}:{text.lines}: more than {MAX_TOTAL} measurements")
    return value_us, count


def _check_summaries(path: Path, text: _Text, series: str, value_us: Int64s, count: Int64s) -> None:
    """Refuse a log whose summary was not made from its bins."""
    if not count.size:
        return
    found = [text.summaries[key] for key in ("xlabel", series) if key in text.summaries]
    if not found:
        raise UsageError(f"{path}:{text.lines}: no summary with MIN, AVG and MAX of the bins")
    mean = float(np.dot(value_us.astype(np.float64), count)) / int(count.sum())
    for printed in found:
        for name, says, holds, tolerance in (
            ("MIN", printed.min_us, float(value_us[0]), TOLERANCE_US),
            ("MAX", printed.max_us, float(value_us[-1]), TOLERANCE_US),
            ("AVG", printed.avg_us, mean, MEAN_TOLERANCE_US),
        ):
            if abs(says - holds) > tolerance:
                raise UsageError(
                    f"{path}:{printed.line}: the summary's {name} is {says:.0f} us, that of the bins {holds:.0f} us"
                )


def _without_padding(entries: tuple[Ranked, ...]) -> tuple[Ranked, ...]:
    """The list without an entry whose index stood in it before.

    In 2014 a list that did not fill was padded with the opposite bound and index 0. If index 0 is not in the list
    otherwise, its value is that bound: the values beyond the bound would all have found a place.
    """
    first = {entry.index: entry for entry in reversed(entries)}
    return tuple(entry for entry in entries if first[entry.index] is entry)


def _of_these_bins(
    which: str, entries: tuple[Ranked, ...], value_us: Int64s, count: Int64s, remarks: list[str]
) -> tuple[Ranked, ...]:
    """The list if it is one of these bins, which come in its order."""
    values = np.repeat(value_us[:LISTED], np.minimum(count[:LISTED], LISTED))[: len(entries)]
    if len(values) == len(entries) and all(
        abs(entry.value_us - int(value)) <= TOLERANCE_US for entry, value in zip(entries, values, strict=True)
    ):
        return entries
    remarks.append(f"the list of {which} values does not belong to the bins: its indices are left out")
    return ()
