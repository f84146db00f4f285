"""What is observed of each release of ROS 2 whose libraries differ, beside what a program of it writes down itself."""

from pathlib import Path

import numpy as np
import pytest
from probes import standin
from probes.standin import find, observed, running

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.interval import STREAM as INTERVAL
from rtrun.kinds.messages import STREAM as MESSAGES
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
        accumulator.observe(observable.program for observable in find(here, process.pid))
        for result in observed(here, process.pid, for_s=7):
            if isinstance(result, Batch):
                for reading in result.clocks:
                    accumulator.offset(*reading)
                accumulator.feed([*result.hits, *result.gaps])
        printed = [line.split() for line in iter(process.stdout.readline, "done\n")]
    accumulator.finish()
    lines = {
        word: np.array([line[1:] for line in printed if line[0] == word], np.int64) for word in ("timer", "message")
    }
    assert [name for name in standin.left() if "raw" in name] == []
    return list(streams(accumulator)), lines


def test_timers_and_messages(release, seen):
    found, printed = seen
    are_timers_as_told(release, found, printed["timer"])
    are_messages_as_told(found, printed["message"])


def are_timers_as_told(release, found, printed):
    timers = [stream for stream in found if stream.kind is TIMER]
    assert [stream.identity["timer"] for stream in timers] == ["timer 5 ms", "timer 5 ms#2"]
    begun = {int(due): int(begun) for _, due, begun in printed}
    for stream in timers:
        assert stream.identity["clock"] == CLOCKS[release]
        due, real = (stream.columns[name].tolist() for name in ("expected_ns", "real_ns"))
        differ = [real_ns - begun[due_ns] for due_ns, real_ns in zip(due, real, strict=True)]
        # Of the first call it is not known when it was due; on a busy machine the clock may be read late.
        assert len(differ) > COUNT * 0.6 and stream.counts["calls"] - len(differ) < COUNT * 0.05
        assert abs(np.median(differ)) < 20_000


def are_messages_as_told(found, printed):
    """Two publishers of a topic, at the same time; of the first each fiftieth message is lost."""
    pairs = sorted((stream for stream in found if stream.kind is MESSAGES), key=lambda stream: -stream.counts["lost"])
    assert [stream.counts["lost"] > 0 for stream in pairs] == [True, False]
    for publisher, stream in enumerate(pairs):
        counts = stream.counts
        # On a busy machine both may publish at the same microsecond.
        assert counts["duplicate"] == 0 and counts["ambiguous"] < COUNT * 0.02
        # What was on its way at the begin is not known, nor whether the last ones were lost.
        assert counts["published"] > COUNT * 0.6 and counts["undecided"] <= 2
        # The program looks at its clock before it publishes, and when it has the message, before the probe each time.
        published, taken = printed[printed[:, 0] == publisher][:, 1:].T
        row = np.searchsorted(published, stream.columns["publication_ns"], side="right") - 1
        assert np.unique(row).size == row.size == counts["received"]
        before_ns, after_ns = (
            stream.columns["publication_ns"] - published[row],
            stream.columns["reception_ns"] - taken[row],
        )
        assert min(before_ns.min(), after_ns.min()) >= 0
        assert max(np.median(before_ns), np.median(after_ns)) < 20_000
        lost = row[-1] // 49 - row[0] // 49 if publisher == 0 else 0
        assert lost - counts["ambiguous"] <= counts["lost"] <= lost
    (takes,) = (stream for stream in found if stream.kind is INTERVAL and stream.identity["end"] == "subscriber")
    assert takes.counts["unmatched"] <= 1
    decided = sum(takes.counts[name] for name in ("received", "ambiguous", "unmatched"))
    assert takes.counts["received"] == sum(stream.counts["received"] for stream in pairs)
    assert takes.counts["messages"] == decided
