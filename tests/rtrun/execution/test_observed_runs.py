"""What an attempt at a run that observes leaves of its streams."""

import json
from itertools import chain

import pytest
from made_flows import MS, S, gap, hit, node, publish, take
from written import stream_facts, write_record

from rtrun.cli import main
from rtrun.execution.stream_runs import put_aside, write_streams
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures
from rtrun.flows.streams import streams
from rtrun.plan.observation import read_stream_deadline
from rtrun.results.record import ProgramRecord


def test_streams_of_an_earlier_attempt_are_put_aside_and_no_others(tmp_path):
    own, other = "001-observation", "001-observation-r2"
    streams = {f"{own}-messages-a": own, f"{other}-messages-a": other, f"{own}-no-stream": ""}
    for name, observed_by in streams.items():
        (tmp_path / name).mkdir()
        more = {"observed_by": observed_by} if observed_by else {}
        write_record(tmp_path / name, "observed_messages", [], {}, run=name, subject="attached", **more)
    put_aside(tmp_path / own)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {f"{own}-messages-a.old-1", f"{other}-messages-a", f"{own}-no-stream"}


def silent_publisher():
    """It sends for ten seconds, lives on, and is silent for fifty."""
    return [publish(n * 10 * MS) for n in range(1, 1001)]


def untaken():
    """The subscriber takes nothing after ten seconds, and lives on."""
    return [event for n in range(1, 6001) for event in (publish(n * 10 * MS), take(n * 10 * MS + 5, n * 10 * MS))
            if event.event == "publish" or n <= 1000]  # fmt: skip


def timer_that_is_not_called():
    timer = {"timer": 5, "period_ns": 10 * MS, "clock": "steady"}
    return [hit(n * 10 * MS + 5, "timer_call", expected_ns=n * 10 * MS, **timer) for n in range(1, 1001)]


def callback_without_an_end():
    calls = ((hit(n * 10 * MS, "callback_begin", callback=5), hit(n * 10 * MS + 5, "callback_end", callback=5))
             for n in range(1, 1001))  # fmt: skip
    return [*chain.from_iterable(calls), hit(10_010 * MS, "callback_begin", callback=5)]


def gated(tmp_path, capsys, flows, deadline):
    """What `rtrun gate` prints of the only stream with a deadline, and what was written."""
    facts = stream_facts(tmp_path / "facts", read_stream_deadline(deadline))
    (tmp_path / "results").mkdir()
    written = write_streams(tmp_path / "results/001", facts, streams(flows), {})
    assert main(["gate", str(tmp_path / "results"), "--probability", "1e-3", "--json"]) == 1
    (case,) = json.loads(capsys.readouterr().out)["cases"]
    return case, written


@pytest.mark.parametrize(("limit", "misses"), [("45s", 1), ("61s", 0)])
@pytest.mark.parametrize(
    ("hits", "deadline", "n", "silent"),
    [
        (silent_publisher, "interval:/a", 999, "no message in the last 50 s, though its program lives"),
        (untaken, "/a", 1000, "nothing of what was published in the last 49.99 s was taken, though both programs live"),
        (timer_that_is_not_called, "timer:/talker", 1000,
         "a call was due 49.99 s ago and did not come, though its program lives: it hangs, or was cancelled"),
        (callback_without_an_end, "callback:/talker", 1000, "a call began 49.99 s ago and has not ended"),
    ],
)  # fmt: skip
def test_what_hangs_for_good_misses_its_deadline(tmp_path, capsys, hits, deadline, n, silent, limit, misses):
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "talker")])
    flows.feed(hits())
    flows.finish(60 * S)
    case, written = gated(tmp_path, capsys, flows, f"{deadline}={limit}")
    assert any(remark.endswith(f": {silent}") for remark in written.left_out) is bool(misses)
    assert (case["n"], case["misses"]) == (n + misses, misses)


def test_a_timer_that_always_overruns_misses_with_each_period_that_it_skips(tmp_path, capsys):
    """Its callback takes 15 ms of 10 ms. The live view and the verdict have the same figures."""
    calls, skipped = overrunning(600)
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "talker")])
    live = LiveFigures(flows, [read_stream_deadline("timer:/talker=1ms")])
    for place in range(0, len(calls), 100):
        flows.feed(calls[place : place + 100])
        row = live.snapshot(calls[min(place + 99, len(calls) - 1)].at_ns).rows[-1]
    late = [call.at_ns - call.values["expected_ns"] for call in calls]
    misses = sum(late_ns > MS for late_ns in late) + skipped
    assert skipped > 150 and (row.misses, row.lost, row.worst_ns) == (misses, skipped, max(late))
    (stream,) = streams(flows)
    assert stream.period_ns == 10 * MS and stream.counts["skipped"] == skipped and stream.remarks == ()
    case, _ = gated(tmp_path, capsys, flows, "timer:/talker=1ms")
    assert (case["n"], case["misses"]) == (len(calls) + skipped, misses)


def overrunning(number):
    """Calls of a timer as rcl makes them, which moves the next one to a whole period after now, and skipped periods."""
    period_ns, calls, skipped, now_ns, due_ns = 10 * MS, [], 0, 0, 10 * MS
    for _ in range(number):
        now_ns = max(now_ns, due_ns)
        timer = {"timer": 5, "period_ns": period_ns, "clock": "steady", "expected_ns": due_ns}
        calls.append(hit(now_ns, "timer_call", **timer))
        following_ns = due_ns + period_ns
        if following_ns < now_ns:
            following_ns += (1 + (now_ns - following_ns - 1) // period_ns) * period_ns
        skipped += (following_ns - due_ns) // period_ns - 1
        due_ns, now_ns = following_ns, now_ns + 15 * MS
    # Periods after the last call are not seen to be skipped.
    return calls, skipped - ((due_ns - calls[-1].values["expected_ns"]) // period_ns - 1)


def test_a_late_call_that_comes_first_after_a_gap_is_a_miss(tmp_path, capsys):
    """The live view and the verdict count the same."""
    timer = {"timer": 5, "period_ns": 10 * MS, "clock": "steady"}
    late = {1: 4 * MS, 300: 3 * MS, 700: 2 * MS}
    calls = [
        hit(n * 10 * MS + late.get(n, 5), "timer_call", expected_ns=n * 10 * MS, **timer)
        for n in range(1, 1001)
        if not 100 <= n < 300
    ]
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "talker")])
    flows.feed([*calls, gap(0, 0)._replace(from_ns=1000 * MS - 1, until_ns=3000 * MS)])
    row = LiveFigures(flows, [read_stream_deadline("timer:/talker=1ms")]).snapshot(10 * S).rows[-1]
    assert (row.misses, row.lost, row.worst_ns) == (3, None, 4 * MS)
    case, _ = gated(tmp_path, capsys, flows, "timer:/talker=1ms")
    assert (case["n"], case["misses"]) == (800, 3)


def calls_of_a_service(number):
    """A client of process 2 and a server of process 1, a call each 10 ms; and `number` requests that nobody answers."""
    endpoint_values = {"service": "/grasp", "gid0": 7, "gid1": 0}
    for call in range(1, 1001 + number):
        at_ns = call * 10 * MS
        yield hit(at_ns, "request_send", pid=2, endpoint=0xC0, before=call - 1, **endpoint_values)
        yield hit(at_ns + 1, "request_number", pid=2, endpoint=0xC0, number=call)
        if call <= 1000:
            yield hit(at_ns + 2, "request_take", endpoint=0xD0, number=call, taken=1, **endpoint_values)
            yield hit(at_ns + 3, "response_send", endpoint=0xD0, number=call, **endpoint_values)
            yield hit(at_ns + 4, "response_take", pid=2, endpoint=0xC0, service="/grasp", number=call, taken=1)


@pytest.mark.parametrize(("limit", "misses"), [("20ms", 20), ("49.85s", 14), ("61s", 0)])
def test_each_request_without_an_answer_is_a_miss(tmp_path, capsys, limit, misses):
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "arm"), node(2, "planner")])
    flows.feed(calls_of_a_service(20))
    flows.finish(60 * S)
    case, written = gated(tmp_path, capsys, flows, f"service:/grasp={limit}")
    silent = "a request was sent 49.99 s ago and has no answer, though its client lives; and 19 more"
    assert any(remark.endswith(f": {silent}") for remark in written.left_out) is (misses == 20)
    assert (case["n"], case["misses"]) == (1000 + misses, misses)


def test_a_deadline_of_a_node_that_was_not_seen_tells_which_names_there_are(tmp_path):
    """With what people know of them: a node that ran before has the name of its program."""
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "talker"), node(2, "other")])
    flows.feed(sorted(timer_that_is_not_called() + silent_publisher()))
    flows.finish(20 * S)
    talker = ProgramRecord(name="talker", argv=[], pid=42)
    facts = stream_facts(tmp_path / "facts", read_stream_deadline("timer:/truth/truth_talker=1ms"), programs=[talker])
    (unseen,) = write_streams(tmp_path / "001", facts, streams(flows), {}).unseen
    assert unseen == (
        "timer /truth/truth_talker: it was not seen; a node that ran before has the name of its program: "
        "name one of /talker (pid 42; /a)"
    )
