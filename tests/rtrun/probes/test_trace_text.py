"""Decoded events of the kernel as text, against the text that the kernel itself prints of the same events."""

import math
import re
from collections import Counter

import pytest
from probes.standin import TRACING, observed, running

from rtrun.causes.ftrace import parse
from rtrun.probes.hits import Gap, GapCause
from rtrun.probes.session import Batch
from rtrun.probes.trace_text import trace_text
from rtrun.targets.inspection.kernel_trace import read_events, read_symbols

pytestmark = [pytest.mark.trace, pytest.mark.timeout(120)]
EVENTS = [event for event in read_events() if event != "osnoise"]
LINE = re.compile(r" *.+?-(\d+) +\[(\d+)\] (\S+) +(\d+\.\d{6,9}): (.*)")
# What the kernel shows of these are names of its own functions, or words for numbers.
HIDDEN = re.compile(
    r"(?<=hrtimer=)\w+|(?<=function=)(?!hrtimer_wakeup)\S+|(?<=mode=)\S+|(?<==)0x\w+|(?<=: )(0x)?0*(?=\w)"
)


@pytest.fixture
def kernels_own():
    """An instance that records the same events, as text: the first of each CPU, where there is no room for all."""
    instance = TRACING / "instances" / "rtrun-test-text"
    instance.mkdir()
    try:
        (instance / "trace_clock").write_text("mono")
        (instance / "buffer_size_kb").write_text("16384")
        (instance / "options/overwrite").write_text("0")
        for event in EVENTS:
            if (instance / "events" / event / "enable").exists():
                (instance / "events" / event / "enable").write_text("1")
        yield lambda: (instance / "trace").read_text()
    finally:
        (instance / "tracing_on").write_text("0")
        (instance / "events" / "enable").write_text("0")
        instance.rmdir()


def comparable(lines, until_s):
    """Each line without what cannot be alike: its thread, CPU, flags and event. Each instance takes its own time."""
    for line in lines:
        if (match := LINE.fullmatch(line)) and float(match[4]) < until_s:
            tid, cpu, flags, _, text = match.groups()
            yield tid, cpu, flags, HIDDEN.sub("", text)


def recorded_until_s(lines):
    """Up to when the events of every CPU are there."""
    last = {match[2]: float(match[4]) for line in lines if (match := LINE.fullmatch(line))}
    return min(last.values())


def test_the_text_is_that_of_the_kernel(here, standin, kernels_own):
    symbols = read_symbols(here)
    with running(standin, 1000, 3000) as process:
        events = []
        stream = observed(here, process.pid, kernel_events=EVENTS, limit_per_s=400_000)
        for result in stream:
            events += result.kernel if isinstance(result, Batch) else ()
            if len(events) > 5000:
                break
        text = kernels_own().splitlines()
        stream.close()
    lines = "".join(trace_text(events, [], symbols)).splitlines()
    assert len(lines) == len(events)
    # A busy machine may have filled the room of the other long since.
    until_s = recorded_until_s(text)
    mine, its = Counter(comparable(lines, until_s)), Counter(comparable(text, math.inf))
    missing = mine - its
    assert missing.total() < 0.001 * mine.total(), list(missing)[:20]
    kinds = {text.partition(":")[0].partition("(")[0] for *_, text in mine}
    assert {"sched_switch", "sched_waking", "hrtimer_start", "hrtimer_expire_entry", "softirq_raise"} <= kinds
    # What is read from the text later: no line is refused.
    read = list(parse(lines))
    assert None not in read

    # The events of each CPU after a gap begin with what the kernel says where it has lost some.
    middle_ns = events[len(events) // 2].at_ns
    gap = Gap(0, middle_ns, "rest", GapCause.RESTED)
    losses = sum("LOST EVENTS" in line for line in trace_text(events, [gap], symbols))
    assert losses == len({hit.cpu for hit in events[len(events) // 2 :]})
