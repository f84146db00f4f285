"""Messages and callbacks in Chrome's JSON format, as its documentation has it."""

import json

from made_flows import hit, node, publish, take

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.recorder import FlowRecorder
from rtrun.report.flow_trace import flow_trace

PROGRAMS = [
    node(1, "talker", threads=[(1, "talker"), (11, "dds\x1b")]),
    node(2, "listener", threads=[(2, "listener")]),
]
BASE_NS = 28_840_758_484_122


def trace_of(limit):
    recorder = FlowRecorder(limit)
    observed = FlowAccumulator(begin_ns=0, recorder=recorder)
    observed.observe(PROGRAMS)
    hits = []
    for at_ns in range(BASE_NS, BASE_NS + 10_000, 1000):
        hits += [
            publish(at_ns, tid=11), take(at_ns + 300, at_ns), hit(at_ns + 310, "callback_begin", pid=2, callback=9),
            hit(at_ns + 320, "callback_begin", pid=2, callback=8), hit(at_ns + 330, "callback_end", pid=2, callback=8),
            hit(at_ns + 350, "callback_end", pid=2, callback=9),
        ]  # fmt: skip
    observed.feed(hits)
    return json.loads(flow_trace(recorder, PROGRAMS))


def test_messages_are_arrows_between_slices_and_callbacks_nest():
    events = trace_of(1000)["traceEvents"]
    slices = [event for event in events if event["ph"] == "X"]
    assert len(slices) == 40
    for thread in {(event["pid"], event["tid"]) for event in slices}:
        opened = []
        for event in (part for part in slices if (part["pid"], part["tid"]) == thread):
            begin, end = (round(event["ts"] * 1000), round((event["ts"] + event["dur"]) * 1000))
            while opened and opened[-1] <= begin:
                opened.pop()
            assert not opened or end <= opened[-1], "slices overlap"
            opened.append(end)
    arrows = [event for event in events if event["ph"] in "sf"]
    assert len(arrows) == 20
    for event in arrows:
        assert any(
            part["pid"] == event["pid"]
            and part["tid"] == event["tid"]
            and part["ts"] <= event["ts"] < part["ts"] + part["dur"]
            for part in slices
        ), "an arrow without a slice"
        assert (event.get("bp") == "e") == (event["ph"] == "f")
    begins, ends = ({arrow["id"]: arrow for arrow in arrows if arrow["ph"] == phase} for phase in "sf")
    assert begins.keys() == ends.keys()
    assert {round((ends[number]["ts"] - begins[number]["ts"]) * 1000) for number in begins} == {300}
    assert (begins[1]["pid"], begins[1]["tid"], ends[1]["tid"]) == (1, 11, 2)
    assert round(begins[1]["ts"] * 1000) == BASE_NS


def test_processes_and_threads_are_named():
    names = {
        (event["name"], event["tid"]): event["args"]["name"]
        for event in trace_of(1000)["traceEvents"]
        if event["ph"] == "M"
    }
    assert names["thread_name", 11] == "dds?" and names["process_name", 2] == "comm"


def test_it_says_what_is_left_out():
    trace = trace_of(7)
    assert sum(event["ph"] in "Xs" for event in trace["traceEvents"]) > 7
    assert trace["otherData"] == {"left_out": "23 events left out, after the first 7"}
    assert trace_of(1000)["otherData"] == {}
