"""The live view: its figures against those of all values, and its table, lines and JSON."""

import io
import json
import random

import numpy as np
import pytest
from made_flows import MS, S, gap, hit, node, publish, take
from rich.console import Console

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures
from rtrun.flows.streams import streams
from rtrun.flows.values import differences
from rtrun.kinds.known import STREAMS
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.kinds.timer import STREAM as TIMER
from rtrun.plan.observation import read_stream_deadline
from rtrun.probes.hits import Gap, GapCause
from rtrun.report.live import LiveView, live_json, live_line, live_table

DEADLINES = [
    read_stream_deadline("/a=5ms"),
    read_stream_deadline("timer:/talker=100us"),
    read_stream_deadline("/a,/b=6ms"),
    read_stream_deadline("interval:/b=30ms"),
    read_stream_deadline("/nobody=1ns"),
]


@pytest.fixture(scope="module")
def seen():
    """Ten snapshots, a second from each other, and the accumulator after them."""
    chance = random.Random(1)
    observed = FlowAccumulator(begin_ns=0, paths=[("/a", "/b")])
    observed.observe([node(1, "talker"), node(2, "relay")])
    live = LiveFigures(observed, DEADLINES)
    snapshots = []
    for second in range(10):
        hits = [gap(0, 0)._replace(from_ns=4 * S, until_ns=4 * S + 500 * MS)] * (second == 4)
        observed.offset("system", second * S, second)
        for at_ns in range(second * S, (second + 1) * S, 10 * MS):
            late_ns = round(chance.expovariate(1 / 40_000))
            values = {"timer": 7, "period_ns": 10 * MS, "clock": "system", "expected_ns": at_ns + at_ns // S}
            hits += [hit(at_ns + late_ns, "timer_call", **values)]
            sent_ns = at_ns + late_ns + 1000
            taken_ns = sent_ns + round(chance.expovariate(1 / MS)) + 1
            hits += [publish(sent_ns)]
            if chance.random() < 0.98:
                hits += [
                    take(taken_ns, sent_ns),
                    hit(taken_ns + 1, "callback_begin", pid=2, callback=9),
                    publish(taken_ns + 2, "/b", pid=2, endpoint=0xA1),
                    hit(taken_ns + 3, "callback_end", pid=2, callback=9),
                ]
        observed.feed([seen_hit for seen_hit in hits if seen_hit[0] < (second + 1) * S])
        snapshots.append(live.snapshot((second + 1) * S))
    observed.offset("system", 10 * S, 9)
    snapshots.append(live.snapshot(10 * S + 1))
    return observed, snapshots


def values_of(stream):
    columns = stream.columns
    if stream.kind is MESSAGES:
        return columns["reception_ns"] - columns["publication_ns"]
    if stream.kind is TIMER:
        return columns["real_ns"] - columns["expected_ns"]
    if stream.kind.is_between_rows:
        return differences(columns["timestamp_ns"], stream.cuts)
    return columns["end_ns"] - columns["begin_ns"]


def test_figures_are_those_of_all_values(seen):
    observed, snapshots = seen
    by_kind = {kind: [stream for stream in streams(observed) if stream.kind is kind] for kind in STREAMS.values()}
    rows = snapshots[-1].rows
    assert len(rows) == sum(map(len, by_kind.values()))
    for kind, of_kind in by_kind.items():
        for stream, row in zip(of_kind, (row for row in rows if row.kind is kind), strict=True):
            values = values_of(stream)
            assert row.worst_ns == values.max()
            for part, estimate in ((0.5, row.median_ns), (0.99, row.p99_ns)):
                exact = np.quantile(values, part, method="inverted_cdf")
                assert exact <= estimate + 1 <= exact * 1.017 + 2
            if row.deadline_ns is not None:
                assert row.misses == np.count_nonzero(values > row.deadline_ns)
            if kind is MESSAGES:
                assert row.lost == stream.counts["lost"] > 0
    with_deadline = {(row.kind, row.name) for row in rows if row.deadline_ns is not None}
    assert with_deadline == {(deadline.stream, deadline.name) for deadline in DEADLINES[:-1]}


def test_rates_are_of_the_last_second(seen):
    _, snapshots = seen
    timer = [next(row.rate_hz for row in snapshot.rows if row.kind is TIMER) for snapshot in snapshots[:10]]
    assert timer[2] == 100 and timer[4] == pytest.approx(50, abs=2) and timer[9] == 100
    assert snapshots[4].remarks == ("1 gap of 0.5 s together: the kernel lost events",)


def test_a_timer_on_simulated_time_has_no_lateness():
    """Its clock is the node's, not the system's, whose offset is known."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker")])
    live = LiveFigures(observed, [read_stream_deadline("timer:/talker=1ms")])
    for second in range(3):
        observed.offset("system", second * S, 1_795_694_189 * S)
        values = {"timer": 7, "period_ns": 10 * MS, "clock": "ros"}
        times = range(second * S, (second + 1) * S, 10 * MS)
        observed.feed([hit(at_ns + 5, "timer_call", expected_ns=at_ns + 3 * S, **values) for at_ns in times])
        (row,) = live.snapshot((second + 1) * S).rows
    assert (row.n, row.worst_ns, row.misses, row.lost) == (300, None, 0, None)
    assert "is the time simulated?" in next(streams(observed)).remarks[0]


def test_what_is_no_value_after_all_leaves_the_figures():
    """The first copy of a message that is passed on by pointer looks like a message."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(2, "talker")])
    live = LiveFigures(observed)
    observed.feed([publish(10, pid=2), take(5 * MS, 10), hit(5 * MS + 1, "callback_end", pid=2)])
    assert [row.worst_ns for row in live.snapshot(S).rows if row.kind is MESSAGES] == [5 * MS - 10]
    observed.feed([publish(2 * S, pid=2), take(2 * S + 5, 2 * S)])
    observed.feed([hit(2 * S + 9, "callback_begin", pid=2, callback=1, intra_process=1)])
    assert [(row.n, row.worst_ns) for row in live.snapshot(3 * S).rows if row.kind is MESSAGES] == [(0, None)]


def test_time_in_gaps_of_two_cpus_counts_once():
    observed = FlowAccumulator(begin_ns=0)
    gaps = ((4, 6, 1), (0, 3, 0), (1, 2, 1), (2, 5, 1))
    lost = GapCause.EVENTS_LOST
    observed.feed([Gap(a * 10**9, b * 10**9, f"the kernel lost events of CPU {cpu}", lost) for a, b, cpu in gaps])
    (remark,) = LiveFigures(observed).snapshot(10**10).remarks
    reasons = "the kernel lost events of CPU 0, the kernel lost events of CPU 1"
    assert remark == f"4 gaps of 6 s together: {reasons}"


def test_the_table_fits_its_screen(seen):
    _, snapshots = seen
    for width, height in ((100, 24), (60, 24), (100, 7)):
        screen = Console(width=width, height=height, record=True, file=io.StringIO())
        screen.print(live_table(snapshots[9], screen.width, height))
        text = screen.export_text()
        assert max(map(len, text.splitlines())) <= width
        assert "10 s observed" in text and "1 gap" in text
        assert ("more stream" in text) == (height == 7)
    assert "/talker to /relay" in text or "timer 10 ms" in text


def test_a_line_and_json(seen, capsys):
    _, snapshots = seen
    line = live_line(snapshots[9])
    assert line.startswith("10 s: ") and " lost, 1 timer, /a: worst " in line
    # Of intervals those with a deadline alone.
    assert "interval:/b: worst " in line and "interval:/a" not in line
    assert json.loads(live_json(snapshots[9]))["rows"][0]["name"] == "/a"
    for as_json in (False, True):
        with LiveView(as_json=as_json) as view:
            view.show(snapshots[9])
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == line and json.loads(printed[1])["observed_s"] == 10


@pytest.mark.parametrize("text", ["", "/a", "/a=", "/a=5", "cmd_vel=5ms", "interval:a=5ms", "timer:=5ms", "x:/a=5ms",
                                  "/a,=5ms", "/a,b=5ms", "path:/a=5ms"])  # fmt: skip
def test_a_deadline_of_what_cannot_be_is_refused(text):
    """At once: not after the hours for which nothing of this name was seen."""
    with pytest.raises(ValueError, match=r"takes TOPIC|no time above 0|begins with /|two topics"):
        read_stream_deadline(text)


def test_nothing_is_seen_yet():
    snapshot = LiveFigures(FlowAccumulator(begin_ns=0)).snapshot(0)
    assert live_line(snapshot) == "0 s: nothing yet"
    Console(file=io.StringIO()).print(live_table(snapshot, 80, 24))
