"""The standard output of a baseline: checked, and kept as files that reports read."""

import re
from dataclasses import dataclass
from pathlib import Path

from rtfiles import atomic
from rtfiles.errors import UsageError
from rtrun.plan import suites
from rtrun.plan.run import Run
from rtrun.results.importers import cyclictest
from rtrun.results.importers.histogram_file import ENDING, histogram_text


@dataclass(frozen=True, slots=True)
class HardwareGaps:
    """What hwlatdetect found: how many gaps above its threshold, and the longest in microseconds, 0 without one."""

    found: int
    longest_us: int


def read_gaps(text: str) -> HardwareGaps | None:
    """Read the standard output of hwlatdetect; None: it printed no result."""
    longest = re.search(r"^Max Latency: (?:Below threshold|([0-9]{1,12})us)$", text, re.MULTILINE)
    found = re.search(r"^Samples recorded: ([0-9]{1,12})$", text, re.MULTILINE)
    if longest is None or found is None:
        return None
    return HardwareGaps(found=int(found[1]), longest_us=int(longest[1] or 0))


def check_baseline_output(run: Run, text: str) -> str | None:
    """What does not add up in the standard output of a baseline, or None.

    Cyclictest ends all its threads as soon as one of them has the requested number of values, in bins of the histogram
    or above them. On a busy target the others have fewer values then.
    """
    if run.suite != "cyclictest":
        return (
            None if read_gaps(text) else "hwlatdetect printed no result (lines with Max Latency and Samples recorded)"
        )
    try:
        histograms = cyclictest.read_text(Path("cyclictest.stdout"), text, command=_command(run))
        for imported in histograms:
            histogram_text(imported)
    except UsageError as error:
        return str(error)
    measured = [imported.histogram.n for imported in histograms]
    if wrong := _held_otherwise(run, text):
        return wrong
    threads, asked = int(run.parameters["threads"] or 1), int(run.parameters["repetitions"] or 0)
    if len(measured) != threads or min(measured) == 0 or max(measured) < asked:
        return f"{threads} threads were asked for {asked} measurements each, they made {measured}"
    return None


def _command(run: Run) -> str:
    return " ".join(suites.argv(run.suite, "cyclictest", run.parameters))


def _held_otherwise(run: Run, text: str) -> str | None:
    """How cyclictest kept idle CPUs awake otherwise than requested, by the line that it prints, or None."""
    asked = run.parameters["cpu_dma_latency_us"]
    line = re.search(r"^# /dev/cpu_dma_latency set to ([0-9]{1,10})us$", text, re.MULTILINE)
    held = int(line[1]) if line else None
    if held == asked:
        return None
    words = ["nothing" if value is None else f"{value} us" for value in (asked, held)]
    return f"asked to hold /dev/cpu_dma_latency at {words[0]}, it held it at {words[1]}: it needs root for that"


def keep_histograms(folder: Path, run: Run, output: str) -> list[str]:
    """Write the histograms of cyclictest as files that reports read, one for each thread; return their outputs.

    hwlatdetect measures no series, so it has none.
    """
    if run.suite != "cyclictest":
        return []
    printed = folder / f"{run.suite}.stdout"
    text = printed.read_text(encoding="utf-8", errors="replace")
    histograms = cyclictest.read_text(printed, text, command=_command(run))
    outputs = [f"{output}-t{thread}" for thread in range(len(histograms))]
    for name, histogram in zip(outputs, histograms, strict=True):
        atomic.write_text(folder / f"{name}{ENDING}", histogram_text(histogram))
    return outputs
