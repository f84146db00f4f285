"""A publisher of a lifecycle node: what it does not publish while that is not active is no stall."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from probes import standin
from probes.standin import find, observed, running

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import STALL_NS
from rtrun.flows.streams import streams
from rtrun.flows.values import differences
from rtrun.kinds.interval import STREAM as INTERVAL
from rtrun.probes.session import Batch, Began

pytestmark = [pytest.mark.trace, pytest.mark.timeout(120)]


def test_a_deactivated_publisher_is_no_stall(here, tmp_path):
    program = standin.build(tmp_path / "lifecycle", source=Path(__file__).with_name("lifecycle.c"))
    accumulator = FlowAccumulator(begin_ns=0)
    with running(program, stdin=subprocess.PIPE) as process:
        assert process.stdout.readline() == "begins\n"
        accumulator.observe(observable.program for observable in find(here, process.pid))
        batches = observed(here, process.pid, for_s=13)
        for result in batches:
            if isinstance(result, Began):
                process.stdin.close()
            if isinstance(result, Batch):
                accumulator.feed([*result.hits, *result.gaps])
                accumulator.until_ns = result.until_ns
        assert process.stdout.readline() == "done\n"
    accumulator.finish(accumulator.until_ns)
    ends = {
        (stream.identity["topic"], stream.identity["end"]): stream
        for stream in streams(accumulator)
        if stream.kind is INTERVAL
    }
    publisher, subscriber = (ends["/a", end] for end in ("publisher", "subscriber"))
    for stream in (publisher, subscriber):
        assert stream.columns["timestamp_ns"].size == 200 and stream.cuts.tolist() == [100]
        assert differences(stream.columns["timestamp_ns"], stream.cuts).max() < STALL_NS
        assert stream.open_ns == 0
    # It had been silent for more than three seconds at the end, as its deactivation shows.
    assert accumulator.until_ns - publisher.columns["timestamp_ns"][-1] > STALL_NS
    assert publisher.remarks == ("its program deactivated a node 2 times: silence from then on is no stall",)
    assert np.diff(ends["/b", "publisher"].columns["timestamp_ns"]).size == 1099
