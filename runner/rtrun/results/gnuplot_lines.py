"""The lines of a gnuplot log, taken apart but not yet interpreted (see gnuplot_log).

The file is untrusted: its size and the length of its lines are limited, and memory grows with the number of bins that
are not empty, not with the range of the values. A line that does not belong in such a log is refused with ``file:line:
what must stand here``. So no command passes that gnuplot would execute (``system``, backquotes, a pipe as output).
"""

import os
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.figures import IndexedValue
from rtrun.kinds.known import LOGS
from rtrun.kinds.limits import TIME_MAX_NS
from rtrun.kinds.messages import LATENCY

MAX_SIZE_BYTES = 128 << 20  #: a log that is read: 8 million lines, values up to 8 s
MAX_LINE_BYTES = 1 << 20  #: a line of a log
MAX_BINS = 2_000_000  #: bins with values in a log: enough for values up to 2 s

# Within double quotes, gnuplot executes text between backquotes.
_WORDS = r"[^\"`\\\x00-\x1f\x7f]*"
_OUTPUT = re.compile(rf'set output "(?!\|)({_WORDS})\.jpg"')
_COMMANDS = re.compile(
    rf'set (?:title|xlabel|ylabel) "{_WORDS}"'
    r"|set yrange \[0\.7:1?\]|set xrange \[-?[0-9]{1,16}:[0-9]{1,16}\]"
    r"|set logscale y|set xtics add\(500, 1000\)|set terminal jpeg size 1920,1080"
    r"""|plot "-" u 1:2 t '[A-Za-z_]+' w steps""",
    re.ASCII,
)
_BIN = re.compile(r"(#?)(-?[0-9]{1,15})[ \t]+([0-9]{1,12})[ \t]*", re.ASCII)
# Bins as a suite writes them, line after line.
_PLAIN_BINS = re.compile(rb"(?:-?[0-9]{1,15}[ \t]+[0-9]{1,12}\n)+")
_PLAIN_BYTES = 1 << 20
_NUMBER = r"(-?[0-9]{1,15}(?:\.[0-9]{1,6})?)"
_BOUNDS = re.compile(rf"MIN:\s*{_NUMBER}us\s+AVG:\s*{_NUMBER}us\s+MAX:\s*{_NUMBER}us")
_ENTRY = re.compile(rf"{_NUMBER}:([0-9]{{1,12}})")
_LABELS = {label: series for form in LOGS.values() for label, series in form.labels.items()}
_LISTS = {"Indices of top values": "top", "Indices of lowest values": "lowest"}
_INCOMPLETE = re.compile(r"Incomplete: ([0-9]{1,12}) of [0-9]{1,12} measured, (.*)")
COUNTS = {
    "out_of_order": re.compile(r"Messages out of order: ([0-9]{1,12})\b"),
    "missing": re.compile(r"Total of ([0-9]{1,12}) missing messages"),
    "duplicate": re.compile(r"Total of ([0-9]{1,12}) duplicate messages"),
    "not_fired": re.compile(r"^([0-9]{1,12}) timers didn't fire"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Printed:
    """A summary as the log prints it, in microseconds, uncorrected; `line` is its line."""

    min_us: float
    avg_us: float
    max_us: float
    line: int


@dataclass(kw_only=True, slots=True)
class Text:
    """The content of the lines, not yet interpreted. `counts` hold (number, line)."""

    suite: str = ""
    output: str = ""
    incomplete: tuple[int, str] | None = None  # how many were measured, and why not all
    summaries: dict[str, Printed] = field(default_factory=dict)  # by series, "" for a summary without a label
    counts: dict[str, tuple[int, int]] = field(default_factory=dict)
    lists: dict[str, tuple[IndexedValue, ...]] = field(default_factory=dict)
    values: "array[int]" = field(default_factory=lambda: array("q"))
    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    last: dict[str, int] = field(default_factory=dict)  # the last bin, by the mark in front of it: "" or "#"
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


def read_text(path: Path) -> Text:
    """Take a log apart. Raises UsageError ``file:line: what is wrong``."""
    if path.exists() and not path.is_file():
        raise UsageError(f"{path}: not a regular file")
    try:
        with path.open("rb") as stream:
            stream.seek(0, 2)
            if stream.tell() > MAX_SIZE_BYTES:
                raise UsageError(f"{path}: {stream.tell()} bytes, a log has at most {MAX_SIZE_BYTES}")
            stream.seek(0)
            return _read(path, stream)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error


def _read(path: Path, stream: BinaryIO) -> Text:
    lines, text = _Lines(path, stream), Text()
    numbered = iter(lines)
    for line in numbered:
        if line == "# Plot data for gnuplot":
            break
        _read_command(lines, text, line)
    else:
        lines.refuse("no log of a suite: '# Plot data for gnuplot' is missing")
    are_plain_read = False
    for line in numbered:
        if line == "end":
            break
        if line.startswith("# "):
            _read_comment(lines, text, line[2:])
        elif line:
            _read_bin(lines, text, line)
            if not are_plain_read and not line.startswith("#"):
                _read_plain_bins(lines, text)
                are_plain_read = True
    else:
        lines.refuse("cut off: the last line must be 'end'")
    for line in numbered:
        if line:
            lines.refuse(f"nothing may follow 'end', got {_cut(line)}")
    text.lines = lines.number
    return text


def _cut(line: str) -> str:
    return repr(line if len(line) <= 40 else line[:40] + "...")


def _read_command(lines: _Lines, text: Text, line: str) -> None:
    if match := _OUTPUT.fullmatch(line):
        text.output = match[1]
    elif not _COMMANDS.fullmatch(line):
        lines.refuse(f"no log of a suite: no suite writes the command {_cut(line)}")
    elif line.startswith("set xlabel ") and (match := _BOUNDS.search(line)):
        text.summaries["xlabel"] = _printed(match, lines.number)


def check_commands(path: Path) -> None:
    """Refuse a log that is not safe for gnuplot: one with commands that no suite writes, or with another output.

    Raises UsageError ``file[:line]: what is wrong``.
    """
    output = read_text(path).output
    if output != path.stem:
        raise UsageError(f"{path}: it would draw {output}.jpg, not {path.stem}.jpg")


def _printed(match: re.Match[str], line: int) -> Printed:
    return Printed(min_us=float(match[1]), avg_us=float(match[2]), max_us=float(match[3]), line=line)


def _read_comment(lines: _Lines, text: Text, line: str) -> None:
    if match := _BOUNDS.search(line):
        label = line[: match.start()].strip()
        text.summaries[_LABELS.get(label, LATENCY)] = _printed(match, lines.number)
    for suite, form in LOGS.items():
        if match := form.summary.search(line):
            text.suite = suite
            text.counts["asked"] = (int(match[1]), lines.number)
    for name, pattern in COUNTS.items():
        if match := pattern.search(line):
            text.counts[name] = (int(match[1]), lines.number)
    if match := _INCOMPLETE.fullmatch(line):
        text.incomplete = (int(match[1]), match[2])
    for mark, name in _LISTS.items():
        if line.startswith(mark):
            # The first piece is the explanation before the first bar.
            entries = [_ENTRY.fullmatch(piece) for piece in line.split("|")]
            text.lists[name] = tuple(
                IndexedValue(value_ns=round(float(e[1]) * 1000), index=int(e[2])) for e in entries if e
            )


def _read_bin(lines: _Lines, text: Text, line: str) -> None:
    match = _BIN.fullmatch(line)
    if not match:
        lines.refuse(f"a bin must stand here, 'value <TAB>count', not {_cut(line)}")
    value, number = int(match[2]), int(match[3])
    if match[1] and value >= 0:
        lines.refuse(f"only a negative value is commented out, not {_cut(line)}")
    if value <= text.last.get(match[1], -TIME_MAX_NS // 1000):
        lines.refuse(f"the bins must rise, {value} follows {text.last[match[1]]}")
    text.last[match[1]] = value
    if number:
        if len(text.values) == MAX_BINS:
            lines.refuse(f"more than {MAX_BINS} bins that hold something")
        text.values.append(value)
        text.numbers.append(number)


def _read_plain_bins(lines: _Lines, text: Text) -> None:
    """Read the plain bins that follow, many at a time, up to the first line that is not a bin or must be refused."""
    while match := _PLAIN_BINS.match(piece := lines.stream.read(_PLAIN_BYTES)):
        values, numbers = np.fromstring(match[0], np.int64, sep=" ").reshape(-1, 2).T
        filled = np.flatnonzero(numbers)
        if np.any(np.diff(values, prepend=text.last[""]) <= 0) or len(text.values) + filled.size > MAX_BINS:
            break
        text.last[""] = int(values[-1])
        text.values.extend(values[filled].tolist())
        text.numbers.extend(numbers[filled].tolist())
        lines.number += values.size
        lines.stream.seek(match.end() - len(piece), os.SEEK_CUR)
        piece = b""
    lines.stream.seek(-len(piece), os.SEEK_CUR)
