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
    reported = {"period_ns": PERIOD_NS, "clock": "steady", "timer": timer} | values
    return [hit(at + late(call), "timer_call", expected_ns=at + offset(at), **reported) for call, at in enumerate(due)]


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
    called = calls(100)
    del called[40:43], called[10]
    (stream,) = timers(accumulate(called))
    assert stream.counts["skipped"] == 4


def test_nothing_is_skipped_in_a_gap():
    missed = gap(0, 0)._replace(from_ns=20 * PERIOD_NS - 1, until_ns=50 * PERIOD_NS)
    (stream,) = timers(accumulate([*calls(100), missed]))
    assert stream.counts == {"calls": 70, "measured": 70, "skipped": 0}
    assert stream.cuts.tolist() == [19]


def drifting(at_ns):
    return 77 * S + at_ns // 10_000


def executed(call, late_ns, *, tid=1, is_told=True, callback=0xF0):
    """The thread that spins takes a queued call, and its callback takes 2 ms."""
    at_ns, expected_ns = call.values["expected_ns"] + late_ns, call.values["expected_ns"]
    executes = [
        hit(at_ns - 10, "timer_execute", tid=tid, timer=call.values["timer"], expected_ns=expected_ns)
    ] * is_told
    return [
        *executes,
        hit(at_ns, "callback_begin", tid=tid, callback=callback, intra_process=0),
        hit(at_ns + 2 * MS, "callback_end", tid=tid, callback=callback),
    ]


def queued(number, late, **values):
    """A timer of EventsExecutor: thread 9 calls it in time and queues its callback, which begins late on thread 1."""
    return [
        seen_hit
        for place, call in enumerate(calls(number, late=lambda call: 900))
        for seen_hit in (call._replace(tid=9), *executed(call, late(place), **values))
    ]


MADE = [
    hit(1, "timer_init", timer=0xC0, period_ns=PERIOD_NS),
    hit(2, "timer_callback_added", timer=0xC0, callback=0xF0),
    hit(3, "timer_linked", timer=0xC0, node=1),
]


def late_of(stream):
    return (stream.columns["real_ns"] - stream.columns["expected_ns"]).tolist()


def up_to_three_periods(call):
    """Every tenth callback waits behind another one of the thread that spins, which takes 28 ms."""
    return (28 * MS, 18 * MS + 10, 8 * MS + 20)[call % 10] if call % 10 < 3 else 1000


@pytest.mark.parametrize(
    ("called", "is_told"),
    [([], True), (MADE, True), (MADE, False)],
    ids=["ran before, Jazzy", "begins, Jazzy", "begins, Iron"],
)
def test_the_lateness_of_a_queued_timer_ends_where_its_callback_begins(called, is_told):
    """Not where another thread calls it, which is in time."""
    late = [up_to_three_periods(call) for call in range(200)]
    (stream,) = timers(accumulate([*called, *queued(200, up_to_three_periods, is_told=is_told)]))
    assert late_of(stream) == late and stream.remarks == ()
    assert stream.columns["timestamp_ns"].tolist() == [call * PERIOD_NS + late[call - 1] for call in range(1, 201)]
    assert stream.counts == {"calls": 200, "measured": 200, "skipped": 0}


def test_a_queued_timer_whose_callbacks_no_probe_names_has_no_values():
    """Iron does not tell whose callback begins, if the program ran before. The calls alone would say: in time."""
    (stream,) = timers(accumulate(queued(200, up_to_three_periods, is_told=False)))
    assert stream.columns["timestamp_ns"].size == 0 and stream.counts == {"calls": 200, "measured": 0}
    assert stream.remarks == (
        "no lateness: no probe sees where its callback begins: rclcpp may queue it for another thread",
    )


def test_a_program_of_rclcpp_that_begins_no_callback_has_no_values():
    """Its thread that spins hangs; the other one goes on to call the timer in time."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "controller", libraries=("/opt/ros/iron/lib/librclcpp.so",))])
    observed.feed(calls(200))
    (stream,) = timers(observed)
    assert stream.columns["timestamp_ns"].size == 0 and "no probe sees where" in stream.remarks[0]


def test_calls_that_were_taken_for_begins_are_forgotten():
    """That a program is of rclcpp shows late, if its libraries are not known."""
    (stream,) = timers(accumulate([*calls(50, late=lambda call: 0), *queued(200, up_to_three_periods)[200:]]))
    late = [up_to_three_periods(call) for call in range(50, 200)]
    assert late_of(stream) == late and stream.counts["calls"] == 200


def test_a_callback_on_the_thread_of_its_call_is_its_own():
    """As all executors but EventsExecutor do, and that one, too, if it has a thread for timers."""
    hits = [
        seen_hit
        for place, call in enumerate(calls(100, late=lambda call: 900))
        for seen_hit in (call, *executed(call, 1000 + place, is_told=False))
    ]
    (stream,) = timers(accumulate(hits))
    assert late_of(stream) == [1000 + place for place in range(100)]


def test_two_threads_that_call_a_timer_begin_their_own_callbacks():
    """MultiThreadedExecutor, reentrant: a call may come before the callback of the one before begins."""
    hits = []
    for first, second in zip(*[iter(calls(100, late=lambda call: 900))] * 2, strict=True):
        hits += [first, second._replace(tid=2), *executed(first, 11 * MS), *executed(second, 10_500_000, tid=2)]
    (stream,) = timers(accumulate(hits))
    assert sorted(late_of(stream)) == [10_500_000] * 50 + [11 * MS] * 50


def test_calls_that_were_queued_before_are_not_taken_for_later_ones():
    """Three callbacks wait when the observation begins: were they those of the next calls, all would be in time."""
    seen = [seen_hit for seen_hit in sorted(queued(100, lambda call: 31 * MS)) if seen_hit.at_ns > 5 * PERIOD_NS]
    (stream,) = timers(accumulate(seen))
    assert late_of(stream) == [31 * MS] * 99


def test_a_queued_callback_that_is_due_off_the_grid_is_not_believed():
    """In a release whose data is laid out in another way, what is read there is not when it was due."""
    off = [
        seen_hit._replace(values={**seen_hit.values, "expected_ns": seen_hit.values["expected_ns"] + 1})
        if seen_hit.event == "timer_execute"
        else seen_hit
        for seen_hit in queued(100, lambda call: 31 * MS)
    ]
    (stream,) = timers(accumulate(off))
    assert set(stream.columns) == {"timestamp_ns", "segment"} and stream.counts["measured"] == 100
    assert stream.remarks[0] == "no lateness: not known which of its calls its callbacks belong to"


def test_after_a_gap_the_order_does_not_tell_which_call_a_callback_belongs_to():
    missed = gap(0, 0)._replace(from_ns=50 * PERIOD_NS - 1, until_ns=52 * PERIOD_NS)
    for is_told, measured in ((True, 98), (False, 46)):
        hits = [*MADE, *queued(100, lambda call: 31 * MS, is_told=is_told), missed]
        (stream,) = timers(accumulate(hits))
        assert late_of(stream) == [31 * MS] * measured
        unknown = ("no lateness of 52 callbacks: not known which call of the timer they belong to",)
        assert stream.remarks == (() if is_told else unknown)


def test_a_call_whose_callback_never_begins_shifts_no_later_one():
    """It was cancelled, or its executor ended."""
    hits = queued(100, lambda call: MS)
    dropped = [
        seen_hit for place, seen_hit in enumerate(hits) if not 40 <= place < 80 or seen_hit.event == "timer_call"
    ]
    (stream,) = timers(accumulate(dropped))
    assert set(late_of(stream)) == {MS} and stream.counts["calls"] == 100 and len(late_of(stream)) == 90


def test_jitter_is_that_of_the_callbacks():
    (stream,) = timers(accumulate(queued(100, lambda call: 3 * MS * (call % 2) + 1000)))
    assert set(np.diff(stream.columns["timestamp_ns"])) == {7 * MS, 13 * MS}


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
    called = [seen_hit._replace(values={**seen_hit.values, **values}) for seen_hit in calls(50)]
    observed = accumulate(called)
    if values.get("clock") == "ros":
        for at_ns in (0, S):
            observed.offset("system", at_ns, 1_700_000_000 * S)
    (stream,) = timers(observed)
    assert set(stream.columns) == {"timestamp_ns", "segment"} and stream.columns["timestamp_ns"].size == 50
    assert reason in stream.remarks[0]


def test_timers_that_are_called_once_are_not_listed():
    """As rclpy's spin_once makes them, at the same address each time or not."""
    hits = []
    for at_ns in range(0, 100 * MS, MS):
        handle = 0xD0 + at_ns // MS % 3
        hits += [hit(at_ns, "timer_init", timer=handle, period_ns=MS), hit(at_ns + 10, "timer_call", timer=handle)]
    assert timers(accumulate(hits)) == []


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
    called = sorted(
        [*calls(50), *calls(50, timer=0xC1), *calls(50, timer=0xC2, clock="raw")], key=lambda seen_hit: seen_hit.at_ns
    )
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([])
    observed.observe([node(1, "controller")])
    observed.feed([hit(0, "node_init", node=2, name="leg", namespace="/"), *begun, *called])
    names = [(stream.identity["node"], stream.identity["timer"]) for stream in timers(observed)]
    assert names == [("/arm", "timer 10 ms"), ("/controller", "timer 10 ms"), ("/controller", "timer 10 ms")]


def test_another_period_makes_another_timer():
    called = [*calls(50), *(hit(S + call * 20 * MS, "timer_call", timer=0xC0, period_ns=20 * MS) for call in range(50))]
    found = timers(accumulate(called))
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
