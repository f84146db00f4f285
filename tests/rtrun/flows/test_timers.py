"""Timers of known lateness, on clocks that go on, drift and are set."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_flows import BEGIN_NS, MS, S, gap, hit, node

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import stalled_ns
from rtrun.flows.streams import streams
from rtrun.flows.timers import ClockOffsets
from rtrun.kinds.timer import STREAM as TIMER

PERIOD_NS = 10 * MS


def calls(number, *, late=lambda call: 1000 * (call % 7), offset=lambda at_ns: 0, timer=0xC0, first=0, **values):
    """Calls of a timer, each due a period after the one before, on a clock that is ahead of the hits' one."""
    due = [(first + call) * PERIOD_NS for call in range(1, number + 1)]
    told = {"period_ns": PERIOD_NS, "clock": "steady", "timer": timer} | values
    return [hit(at + late(call), "timer_call", expected_ns=at + offset(at), **told) for call, at in enumerate(due)]


def timers(observed):
    return [stream for stream in streams(observed) if stream.kind is TIMER]


def accumulate(hits, begin_ns=0):
    observed = FlowAccumulator(begin_ns=begin_ns)
    observed.observe([node(1, "controller")])
    observed.feed(hits)
    return observed


def test_lateness_on_the_clock_of_the_hits():
    (stream,) = timers(accumulate(calls(100)))
    assert stream.identity == {"node": "/controller", "timer": "timer 10 ms", "clock": "steady"}
    late = stream.columns["real_ns"] - stream.columns["expected_ns"]
    assert late.tolist() == [1000 * (call % 7) for call in range(100)]
    assert stream.period_ns == PERIOD_NS and stream.remarks == ()
    assert stream.counts == {"calls": 100, "measured": 100, "skipped": 0}


def test_periods_without_a_call_are_counted():
    made = calls(100)
    del made[40:43], made[10]
    (stream,) = timers(accumulate(made))
    assert stream.counts["skipped"] == 4


def test_nothing_is_skipped_in_a_gap():
    missed = gap(0, 0)._replace(from_ns=20 * PERIOD_NS - 1, until_ns=50 * PERIOD_NS)
    (stream,) = timers(accumulate([*calls(100), missed]))
    assert stream.counts == {"calls": 70, "measured": 70, "skipped": 0}
    assert stream.cuts.tolist() == [19]


def drifting(at_ns):
    return 77 * S + at_ns // 10_000


def set_at_half(at_ns):
    return drifting(at_ns) + 50 * MS * (at_ns >= 500 * PERIOD_NS)


@pytest.mark.parametrize(("clock", "read"), [("system", "system"), ("ros", "system"), ("raw", "raw")])
def test_a_clock_that_drifts(clock, read):
    observed = FlowAccumulator(begin_ns=0)
    for at_ns in range(0, 12 * S, S):
        observed.offset(read, at_ns, drifting(at_ns))
    observed.feed(calls(1000, clock=clock, offset=drifting))
    (stream,) = timers(observed)
    late = stream.columns["real_ns"] - stream.columns["expected_ns"]
    assert np.abs(late - [1000 * (call % 7) for call in range(1000)]).max() <= 2
    assert stream.remarks == ()


def test_a_clock_that_is_set_has_no_lateness_around_that():
    observed = FlowAccumulator(begin_ns=0)
    for at_ns in range(S, 9 * S, S):
        observed.offset("system", at_ns, set_at_half(at_ns))
    observed.feed(calls(1000, clock="system", offset=set_at_half))
    (stream,) = timers(observed)
    late = stream.columns["real_ns"] - stream.columns["expected_ns"]
    assert late.min() >= 0 and late.max() <= 6002
    # From the first reading to the last one, but for the second in which the clock was set.
    assert stream.counts["measured"] == 600 and stream.counts["calls"] == 1000
    assert stream.cuts.size == 1
    assert "was set by up to 50" in stream.remarks[0] and "400 calls" in stream.remarks[1]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"clock": "system"}, "not known how its clock (system) stood"),
        ({"clock": 0}, "the clock of its grid is not known"),
        ({"period_ns": PERIOD_NS * 5 // 4}, "period not known"),
        ({"period_ns": "?"}, "period not known"),
        ({"expected_ns": ""}, "no probe tells when"),
        ({"clock": "ros", "expected_ns": 5}, "is the time simulated?"),
        ({"clock": "steady", "expected_ns": 9**18}, "not one of the clock (steady)"),
    ],
)
def test_no_lateness_is_guessed(values, reason):
    made = [one._replace(values={**one.values, **values}) for one in calls(50)]
    observed = accumulate(made)
    if values.get("clock") == "ros":
        for at_ns in (0, S):
            observed.offset("system", at_ns, 1_700_000_000 * S)
    (stream,) = timers(observed)
    assert set(stream.columns) == {"timestamp_ns", "segment"} and stream.columns["timestamp_ns"].size == 50
    assert reason in stream.remarks[0]


def test_timers_that_are_called_once_are_not_listed():
    """As rclpy's spin_once makes them, at the same address each time or not."""
    made = []
    for at_ns in range(0, 100 * MS, MS):
        handle = 0xD0 + at_ns // MS % 3
        made += [hit(at_ns, "timer_init", timer=handle, period_ns=MS), hit(at_ns + 10, "timer_call", timer=handle)]
    assert timers(accumulate(made)) == []


def test_a_timer_of_a_restarted_program_is_measured_on():
    observed = accumulate(calls(100))
    observed.observe([node(1, "controller", start_ticks=7777)])
    observed.feed(calls(100, first=200, timer=0xC8))
    (stream,) = timers(observed)
    assert stream.counts == {"calls": 200, "measured": 200, "skipped": 0} and stream.cuts.tolist() == [100]


def test_timers_of_a_node_are_told_apart():
    begun = [
        hit(1, "node_init", node=1, name="arm", namespace="/"),
        hit(2, "timer_init", timer=0xC0, period_ns=PERIOD_NS),
        hit(3, "timer_linked", timer=0xC0, node=1),
    ]
    told = sorted([*calls(50), *calls(50, timer=0xC1), *calls(50, timer=0xC2, clock="raw")], key=lambda one: one.at_ns)
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([])
    observed.observe([node(1, "controller")])
    observed.feed([hit(0, "node_init", node=2, name="leg", namespace="/"), *begun, *told])
    names = [(stream.identity["node"], stream.identity["timer"]) for stream in timers(observed)]
    assert names == [("/arm", "timer 10 ms"), ("/controller", "timer 10 ms"), ("/controller", "timer 10 ms")]


def test_another_period_makes_another_timer():
    made = [*calls(50), *(hit(S + call * 20 * MS, "timer_call", timer=0xC0, period_ns=20 * MS) for call in range(50))]
    found = timers(accumulate(made))
    assert [stream.period_ns for stream in found] == [10 * MS, 20 * MS]
    assert [stream.counts["calls"] for stream in found] == [50, 50]


@pytest.mark.parametrize(
    ("passed_ns", "moved_ns", "is_followed"),
    [
        (10 * S, 5 * MS, True),
        (10 * S, -5 * MS, True),
        (10 * S, 5 * MS + 30_000, False),
        (MS, 20_000, True),
        (MS, 21_000, False),
    ],
)
def test_a_clock_may_drift_by_500_ppm_and_20_us_and_steps_beyond(passed_ns, moved_ns, is_followed):
    """As NTP disciplines it, and as two readings on a busy machine differ."""
    offsets = ClockOffsets()
    offsets.add("system", 0, 0)
    offsets.add("system", passed_ns, moved_ns)
    offset, known, step_ns = offsets.read("system", np.array([passed_ns // 2]))
    assert (known.tolist(), step_ns) == ([is_followed], 0 if is_followed else abs(moved_ns))
    assert not is_followed or offset.tolist() == [moved_ns // 2]


@pytest.mark.parametrize(
    ("passed_ns", "longest_ns", "is_stalled"),
    [(3 * S, 0, False), (3 * S + 1, 0, True), (4 * S, 4 * S, False), (4 * S, 3 * S, True)],
)
def test_what_has_not_come_for_three_seconds_and_longer_than_ever_is_stalled(passed_ns, longest_ns, is_stalled):
    observed = SimpleNamespace(until_ns=BEGIN_NS + passed_ns)
    assert stalled_ns(BEGIN_NS, longest_ns, observed) == (passed_ns if is_stalled else 0)
