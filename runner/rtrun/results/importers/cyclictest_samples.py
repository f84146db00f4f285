"""Reader of the text of ``cyclictest -v``, which has every value in the order of measurement.

Every 10 ms cyclictest prints what each thread has measured since, a line for each value: ``thread: counter: value``.
The counter begins at 0 and rises by one. It does not rise at a value of 0, which once was not a new maximum. ``-o``
leaves values out, which makes gaps in the counter. No line marks the end of the text: a missing end is noticed only
where it cuts a line. ``-h`` adds a histogram of all values, including those measured after the last line. The interval
is not known: ``Thread 0 Interval:`` states that of the next thread.
"""

import re
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.quantities import time
from rtfiles.untrusted import MIB, lines_in, read_beginning
from rtrun.analysis.histogram import Histogram
from rtrun.kinds.limits import CPUS_MAX, TIME_MAX_NS
from rtrun.kinds.values import Int64s
from rtrun.results.importers.counts import NO_INTERVAL
from rtrun.results.importers.cyclictest import NO_OPTIONS, NO_UNIT, read_text
from rtrun.results.importers.samples_file import ImportedSamples

LINES_MAX = 20_000_000  #: lines of a text of `cyclictest -v`
_HISTOGRAM_BYTES_MAX = 16 * MIB  #: the histogram at the end of such a text
_BEGINNING = 65_536
_SAMPLE = re.compile(  # --smi adds a number of interrupts
    rb"[ \t]*([0-9]{1,5}):[ \t]*([0-9]{1,12}):[ \t]*([0-9]{1,15})(?:[ \t]+[0-9]{1,12})?[ \t]*\r?\n", re.ASCII
)
_ANNOUNCED = re.compile(rb"Thread ([0-9]{1,5}) Interval: [0-9]{1,9}[ \t]*\r?\n", re.ASCII)
_UNIT_NS = 1000
# Values wait in a ring of this size to be printed. If they are read too slowly, newer values overwrite them.
_RING = 16_384
_REPEATED = 512  # so many values do not repeat by chance, unless they hardly differ


@dataclass(kw_only=True, slots=True)
class _Thread:
    """The values of a thread, and the counter that its next line must have if its value is 0."""

    values: "array[int]" = field(default_factory=lambda: array("q"))
    shown: int = 0


def has_samples(path: Path) -> bool:
    """Whether a file begins like the text of ``cyclictest -v``. Raises UsageError for anything but a regular file."""
    lines = read_beginning(path, max_bytes=_BEGINNING).split(b"\n")[:-1]
    return any(_SAMPLE.fullmatch(line + b"\n") for line in lines)


def read_samples(path: Path, *, unit_ns: int | None = None) -> tuple[ImportedSamples, ...]:
    """Read the values of each thread; `unit_ns` is the unit, if the caller knows it.

    Raises UsageError ``file:line: what is wrong``.
    """
    threads: dict[int, _Thread] = {}
    announced: set[int] = set()
    histogram: str | None = None
    lines = lines_in(path)
    for number, line in enumerate(lines, start=1):
        if number > LINES_MAX:
            raise UsageError(f"{path}: more than {LINES_MAX} lines")
        if match := _SAMPLE.fullmatch(line):
            thread, counter, value = match.groups()
            if wrong := _keep(threads, int(thread), int(counter), int(value), unit_ns or _UNIT_NS):
                raise UsageError(f"{path}:{number}: thread {int(thread)}: {wrong}")
        elif line.startswith((b"# Histogram", b"# Total:", b"# Min Latencies:")):
            histogram = _rest(path, number, line, lines)
        elif match := _ANNOUNCED.fullmatch(line):
            announced.add(int(match[1]))
        elif threads and line.strip() and not line.startswith(b"#"):
            cut = "cut off, " if not line.endswith(b"\n") else ""
            words = line.decode("utf-8", "replace").strip()[:40]
            raise UsageError(f"{path}:{number}: {cut}expected 'thread: counter: value', got {words!r}")
    for thread in range(max([0, *threads, *announced]) + 1):
        if thread not in threads:
            raise UsageError(f"{path}: thread {thread}: no value, expected one at least of each of the threads from 0")
    samples = tuple(_samples(path, thread, threads[thread], unit_ns) for thread in sorted(threads))
    samples = tuple(replace(imported, parameters={"threads": len(samples)}) for imported in samples)
    if histogram is not None:
        _check_histograms(path, samples, histogram, unit_ns)
    return samples


def _keep(threads: dict[int, _Thread], number: int, counter: int, value: int, unit_ns: int) -> str:
    """Keep a value, or return what is wrong with it."""
    thread = threads.get(number)
    if thread is None:
        if number >= CPUS_MAX:
            return f"expected less than {CPUS_MAX} threads"
        thread = threads[number] = _Thread()
    if value:
        thread.shown = len(thread.values)
    if counter != thread.shown:
        return f"a counter of {counter}, expected {thread.shown}: values are missing, or -o left them out"
    if value > TIME_MAX_NS // unit_ns:
        return f"a value of {value}, expected at most {TIME_MAX_NS // unit_ns}"
    thread.values.append(value * unit_ns)
    return ""


def _samples(path: Path, number: int, thread: _Thread, unit_ns: int | None) -> ImportedSamples:
    values = np.frombuffer(thread.values, dtype=np.int64)
    if (repeated := _overwritten(values)) is not None:
        raise UsageError(
            f"{path}: thread {number}: from counter {repeated} on the values are those of {_RING} later: cyclictest"
            " overwrote what it had not printed yet. Print to a file, with a longer interval"
        )
    return ImportedSamples(
        source="cyclictest",
        name=f"cyclictest-t{number}",
        values_ns=values,
        period_ns=None,
        left_out=(
            NO_INTERVAL,
            *(() if unit_ns else (NO_UNIT,)),
            NO_OPTIONS,
            "what was measured after the last line: nothing ends the text",
        ),
        parameters={},
    )


def _overwritten(values: Int64s) -> int | None:
    """The index of the first value that a newer one overwrote before it was printed, or None.

    Such values equal those that come one ring later. Values that are nearly constant or periodic do too, without being
    overwritten; these compress to less than a bit each.
    """
    differ = np.flatnonzero(values[:-_RING] != values[_RING:])
    edges = np.concatenate(([-1], differ, [max(0, values.size - _RING)]))
    for place in np.flatnonzero(np.diff(edges) > _REPEATED):
        run = values[edges[place] + 1 : edges[place + 1]]
        if 8 * len(zlib.compress(run.tobytes())) > run.size:
            return int(edges[place]) + 1
    return None


def _rest(path: Path, number: int, line: bytes, lines: Iterator[bytes]) -> str:
    """The rest of the file from `line` on, as a text of a histogram; its lines keep their numbers."""
    kept, size = [b"\n" * (number - 1)], 0
    for next_line in chain([line], lines):
        size += len(next_line)
        if size > _HISTOGRAM_BYTES_MAX:
            raise UsageError(f"{path}: a histogram of more than {_HISTOGRAM_BYTES_MAX} bytes")
        kept.append(next_line)
    return b"".join(kept).decode("utf-8", "replace")


def _check_histograms(path: Path, samples: tuple[ImportedSamples, ...], text: str, unit_ns: int | None) -> None:
    """Refuse samples that do not fit into the histogram of the same values."""
    histograms = read_text(path, text, unit_ns=unit_ns)
    if len(histograms) != len(samples):
        raise UsageError(f"{path}: values of {len(samples)} threads, but a histogram of {len(histograms)}")
    for thread, other in zip(samples, histograms, strict=True):
        if (wrong := _beyond(thread.values_ns, other.histogram)) is not None:
            raise UsageError(f"{path}: {thread.name}: more values of {time(wrong)} than the histogram holds")


def _beyond(values_ns: Int64s, histogram: Histogram) -> int | None:
    """A value in ns that occurs more often among the samples than in the histogram, or None."""
    values, counts = np.unique(values_ns, return_counts=True)
    inside = dict(zip(histogram.values_ns.tolist(), histogram.counts.tolist(), strict=True))
    left = histogram.overflow
    for value, count in zip(values.tolist(), counts.tolist(), strict=True):
        if histogram.overflow_from_ns is not None and value >= histogram.overflow_from_ns:
            left -= count
            if left < 0 or (histogram.max_ns is not None and value > histogram.max_ns):
                return int(value)
        elif count > inside.get(value, 0):
            return int(value)
    return None
