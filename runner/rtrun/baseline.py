"""What a baseline said of its run, from its standard output."""

import re
from pathlib import Path

from rtfiles import atomic
from rtrun.campaign import Run
from rtrun.importers import cyclictest
from rtrun.importers.histogram_file import ENDING, histogram_text

_TOTAL = re.compile(r"^# Total:((?: [0-9]{1,18})+)\s*$", re.MULTILINE | re.ASCII)
_OVERFLOWS = re.compile(r"^# Histogram Overflows:((?: [0-9]{1,18})+)\s*$", re.MULTILINE | re.ASCII)
_BINS = re.compile(r"^([0-9]{6,9}) ([0-9\t ]+)$", re.MULTILINE | re.ASCII)


def contradiction(run: Run, said: str) -> str | None:
    """Say what does not add up in what a baseline printed, or None.

    Each thread of cyclictest must have measured as often as it was asked to, in a bin of the histogram or above it.
    """
    if run.suite != "cyclictest":
        return None if "Max Latency" in said else "hwlatdetect printed no result (a line with Max Latency)"
    totals, overflows = _TOTAL.search(said), _OVERFLOWS.search(said)
    if totals is None or overflows is None:
        return "cyclictest printed no histogram (a line with # Total)"
    binned = [int(number) for number in totals[1].split()]
    above = [int(number) for number in overflows[1].split()]
    threads, asked = int(run.parameters["threads"] or 1), int(run.parameters["repetitions"] or 0)
    measured = [a + b for a, b in zip(binned, above, strict=False)]
    if len(measured) != threads or min(measured) < asked:
        return f"{threads} threads were asked for {asked} measurements each, they made {measured}"
    sums = [0] * threads
    for _, counts in _BINS.findall(said):
        for thread, count in enumerate(counts.split()[:threads]):
            sums[thread] += int(count)
    return f"the bins add up to {sums}, the totals say {binned}" if sums != binned else None


def keep_histograms(folder: Path, run: Run, output: str) -> list[str]:
    """Write what a baseline printed as files that reports read, one a thread of cyclictest; return their outputs.

    hwlatdetect measures no series: it has none.
    """
    if run.suite != "cyclictest":
        return []
    printed = folder / f"{run.suite}.stdout"
    found = cyclictest.read_text(printed, printed.read_text(encoding="utf-8"))
    outputs = [f"{output}-t{thread}" for thread in range(len(found))]
    for name, histogram in zip(outputs, found, strict=True):
        atomic.write_text(folder / f"{name}{ENDING}", histogram_text(histogram))
    return outputs
