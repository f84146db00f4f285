"""What is observed of each release of ROS 2 whose libraries differ, beside what a program of it writes down itself."""

from pathlib import Path

import numpy as np
import pytest
from probes import standin
from probes.standin import find, observed, running

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.timer import STREAM as TIMER
from rtrun.probes.session import Batch

pytestmark = [pytest.mark.trace, pytest.mark.timeout(120)]
SOURCE = Path(__file__).with_name("released.c")
LIBRARIES = ("tracetools", "rcl", "rmw_cyclonedds_cpp")
CLOCKS = {"HUMBLE": "raw", "KILTED": "steady", "LYRICAL": "steady"}
COUNT = 1000


@pytest.fixture(params=CLOCKS)
def release(request):
    return request.param


@pytest.fixture
def seen(here, tmp_path, release):
    """The streams of a program, and the lines that it prints, each without its first word."""
    program = standin.build(tmp_path / "released", source=SOURCE, libraries=LIBRARIES, defined=[release])
    accumulator = FlowAccumulator(begin_ns=0)
    with running(program, COUNT) as process:
        accumulator.observe(each.program for each in find(here, process.pid))
        for each in observed(here, process.pid, for_s=7):
            if isinstance(each, Batch):
                for reading in each.clocks:
                    accumulator.offset(*reading)
                accumulator.feed([*each.hits, *each.gaps])
        told = [line.split() for line in iter(process.stdout.readline, "done\n")]
    accumulator.finish()
    lines = {word: np.array([line[1:] for line in told if line[0] == word], np.int64) for word in ("timer", "message")}
    assert standin.left() == []
    return list(streams(accumulator)), lines


def test_timers(release, seen):
    found, told = seen
    timers = [stream for stream in found if stream.kind is TIMER]
    assert [stream.identity["timer"] for stream in timers] == ["timer 5 ms", "timer 5 ms#2"]
    begun = {int(due): int(begun) for _, due, begun in told["timer"]}
    for stream in timers:
        assert stream.identity["clock"] == CLOCKS[release] and stream.remarks == ()
        due, real = (stream.columns[name].tolist() for name in ("expected_ns", "real_ns"))
        differ = [real_ns - begun[due_ns] for due_ns, real_ns in zip(due, real, strict=True)]
        assert len(differ) > COUNT * 0.6
        assert abs(np.median(differ)) < 20_000
