"""Callbacks, and what was published in them: a message belongs to another one only where that is certain."""

import pytest
from made_flows import MS, S, gap, hit, node, program, publish, publish_bytes, take, take_bytes

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.streams import streams
from rtrun.kinds.callback import STREAM as CALLBACK
from rtrun.kinds.interval import STREAM as INTERVAL
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.kinds.path import STREAM as PATHS

PATH = ("/scan", "/objects", "/cmd")
SCAN, OBJECTS = 0xA0, 0xA1


def begin(at_ns, callback=0xF0, pid=2, tid=None, **values):
    return hit(at_ns, "callback_begin", pid=pid, tid=tid, callback=callback, **values)


def end(at_ns, callback=0xF0, pid=2, tid=None):
    return hit(at_ns, "callback_end", pid=pid, tid=tid, callback=callback)


def event(at_ns, event_name, /, pid=2, tid=None, **values):
    return hit(at_ns, event_name, pid=pid, tid=tid, **values)


def sent(at_ns, topic="/scan", pid=1, endpoint=SCAN, tid=None):
    return publish(at_ns, topic, pid=pid, endpoint=endpoint, tid=tid)


def got(at_ns, stamp_ns, topic="/scan", pid=2, endpoint=0xB0, tid=None, taken=1):
    return take(at_ns, stamp_ns, topic, pid=pid, endpoint=endpoint, tid=tid, taken=taken)


def out(at_ns, pid=2, tid=None):
    return publish(at_ns, "/objects", pid=pid, endpoint=OBJECTS, tid=tid)


def of_kind(observed, kind):
    return [stream for stream in streams(observed) if stream.kind is kind]


def accumulate(hits, paths=(("/scan", "/objects"),), recorder=None):
    observed = FlowAccumulator(begin_ns=0, paths=paths, recorder=recorder)
    observed.observe([node(1, "lidar"), node(2, "detector"), node(3, "driver")])
    observed.feed(hits)
    observed.finish()
    return observed


def reactions(observed):
    """Times from the first message of the path to the last, and how many of the last ones came from nothing known."""
    paths = of_kind(observed, PATHS)
    if not paths:
        return [], 0
    (stream,) = paths
    return (stream.columns["end_ns"] - stream.columns["begin_ns"]).tolist(), stream.counts["unknown"]


A, B = [sent(100), sent(110)], [got(200, 100), got(300, 110)]
OTHER = [sent(105, "/map", endpoint=0xA7), got(250, 105, "/map", endpoint=0xB7)]
SEVERAL = [
    # rclcpp: callbacks are seen.
    ("in the callback", [A[0], B[0], begin(210), out(220), out(230), end(240)], [120, 130], 0),
    ("after the callback", [A[0], B[0], begin(210), end(215), out(220)], [], 1),
    ("a timer's callback", [A[0], B[0], begin(210), end(215), event(216, "timer_call", timer=1), begin(217, 0xF1),
                            out(220), end(230, 0xF1)], [], 1),
    ("a service's callback", [A[0], B[0], begin(210), end(215), begin(217, 0xF1), out(220), end(230, 0xF1)], [], 1),
    ("a callback in a callback", [A[0], B[0], begin(210), *OTHER[:1], begin(251, 0xF1), out(252), end(253, 0xF1),
                                  out(254), end(255)], [154], 1),
    ("another thread", [A[0], B[0], begin(210), out(220, tid=9), end(240)], [], 1),
    ("something between", [A[0], B[0], event(205, "request_take"), begin(210), out(220), end(240)], [], 1),
    ("a callback of several", [*A, B[0], begin(210), out(220), end(240), *OTHER, begin(260), out(270), end(280)],
     [120], 1),
    ("nothing was taken", [A[0], got(200, 100, taken=0), begin(210), out(220), end(240)], [], 1),
    ("an exception", [A[0], B[0], begin(210), begin(212, 0xF1), out(214), end(240), out(250)], [], 2),
    # rclpy: a guard condition is triggered before and after each callback.
    ("rclpy", [A[0], B[0], event(210, "guard_trigger"), out(220), event(230, "guard_trigger"), out(240)], [120], 1),
    ("rclpy again", [*A, B[0], event(210, "guard_trigger"), event(230, "guard_trigger"), B[1], out(305),
                     event(310, "guard_trigger"), out(320)], [210], 1),
    # C: it is seen to wait.
    ("rcl", [event(150, "wait"), A[0], B[0], out(220), event(230, "wait"), out(240)], [120], 1),
    ("rcl, wait not seen", [A[0], B[0], out(220)], [], 1),
    ("rclc takes all first", [event(150, "wait"), *A, B[0], B[1], out(320), out(330)], [], 2),
    ("rcl, timer first", [event(150, "wait"), A[0], event(160, "timer_call", timer=1), B[0], out(220)], [], 1),
]  # fmt: skip


@pytest.mark.parametrize(("hits", "expected", "unknown"), [row[1:] for row in SEVERAL], ids=[row[0] for row in SEVERAL])
def test_what_is_published_in_a_callback(hits, expected, unknown):
    assert reactions(accumulate(hits)) == (expected, unknown)


def inner(call, *, first=True, other=(), own=0):
    """Process 2 publishes /scan for itself, by pointer, and for others outside: the copy is taken and discarded.

    The copy comes before its callback begins, or after it has ended; `other` is what the thread does next.
    """
    at_ns = (call + 1) * 10 * MS
    copy = got(at_ns + MS, at_ns)
    by_pointer = [begin(at_ns + 2 * MS, 0xF3, intra_process=1), out(at_ns + 2 * MS + 1), end(at_ns + 3 * MS, 0xF3)]
    outside = got(at_ns + MS, at_ns, pid=3, endpoint=0xB3)
    if not first:
        copy = copy._replace(at_ns=at_ns + 4 * MS)
    return sorted([sent(at_ns, pid=2), outside, copy, *by_pointer, *other])


def service(call):
    at_ns = (call + 1) * 10 * MS + 5 * MS
    return [begin(at_ns, 0xF5, intra_process=0), out(at_ns + 1), end(at_ns + 2, 0xF5)]


@pytest.mark.parametrize("first", [True, False])
def test_copies_that_rclcpp_discards_are_no_messages(first):
    """As subscription.hpp does with what came from a publisher of its own process."""
    recorder = FlowRecorder(10_000)
    observed = accumulate([event for call in range(50) for event in inner(call, first=first, other=service(call))],
                          recorder=recorder)  # fmt: skip
    found = {stream.identity["subscriber"]: stream for stream in of_kind(observed, MESSAGES)}
    assert found["/driver"].counts["received"] == 50 and found["/driver"].counts["lost"] == 0
    assert all(column.size == 0 for column in found["/detector"].columns.values())
    assert found["/detector"].counts == {"copies": 50}
    assert found["/detector"].remarks[0].startswith("no values: rclcpp passes messages on by pointer")
    ends = {(stream.identity["end"], stream.identity["node"]): stream for stream in of_kind(observed, INTERVAL)}
    assert ends["subscriber", "/detector"].columns["timestamp_ns"].size == 0
    assert ends["subscriber", "/driver"].columns["timestamp_ns"].size == 50
    # Neither callback has the name of the topic, and what they publish comes from nothing known.
    assert {stream.identity["callback"] for stream in of_kind(observed, CALLBACK)} == {"unknown", "unknown#2"}
    assert reactions(observed) == ([], 100)


def test_copies_are_no_messages_of_a_callback_that_is_known():
    inits = [
        event(1, "subscription_init", subscription=10, node=1, endpoint=0xB0, topic="/scan", depth=1),
        event(2, "subscription_linked", subscription=10, object=21),
        event(3, "callback_added", object=21, callback=0xF3),
        event(4, "subscription_linked", subscription=10, object=20),
        event(5, "callback_added", object=20, callback=0xF0),
    ]
    observed = accumulate([*inits, *(event for call in range(50) for event in inner(call))])
    found = {stream.identity["subscriber"]: stream for stream in of_kind(observed, MESSAGES)}
    assert found["/detector"].counts == {"copies": 50}
    assert {stream.identity["callback"] for stream in of_kind(observed, CALLBACK)} == {"/scan"}
    assert reactions(observed) == ([], 50)


def test_messages_from_outside_are_real_where_others_are_copies():
    """Process 1 publishes for a subscription of process 2 that also has a publisher in its own process."""
    hits = []
    for call in range(50):
        at_ns = (call + 1) * 10 * MS
        outside = [sent(at_ns + 5 * MS, pid=1), got(at_ns + 6 * MS, at_ns + 5 * MS)]
        called = [begin(at_ns + 6 * MS + 1, intra_process=0), out(at_ns + 7 * MS), end(at_ns + 8 * MS)]
        hits += inner(call, other=outside + called)
    observed = accumulate(hits)
    found = {
        (stream.identity["publisher"], stream.identity["subscriber"]): stream for stream in of_kind(observed, MESSAGES)
    }
    assert found["/lidar", "/detector"].counts["received"] == 50
    assert found["/lidar", "/detector"].columns["callback_end_ns"].size == 50
    assert found["/detector", "/detector"].counts == {"copies": 50}
    assert reactions(observed) == ([2 * MS] * 50, 50)


def test_a_process_without_pointers_receives_its_own_messages():
    """Two nodes in one process, without intra-process communication."""
    hits = []
    for call in range(50):
        at_ns = (call + 1) * 10 * MS
        hits += [sent(at_ns, pid=2), got(at_ns + MS, at_ns), begin(at_ns + MS + 1, intra_process=0)]
        hits += [out(at_ns + 2 * MS), end(at_ns + 3 * MS)]
    observed = accumulate(hits)
    (messages,) = of_kind(observed, MESSAGES)
    assert messages.counts["received"] == 50
    assert [stream.identity["callback"] for stream in of_kind(observed, CALLBACK)] == ["/scan"]
    # Until some calls have not shown that they are copies, nothing counts as coming from them.
    assert reactions(observed) == ([2 * MS] * 42, 8)


def test_a_path_of_three_topics():
    hits = []
    for start in range(0, 1000 * MS, 10 * MS):
        hits += [
            sent(start),
            got(start + MS, start), begin(start + MS + 1), out(start + 2 * MS), end(start + 3 * MS),
            got(start + 4 * MS, start + 2 * MS, "/objects", 3), begin(start + 4 * MS + 1, pid=3),
            publish(start + 5 * MS, "/cmd", pid=3), end(start + 6 * MS, pid=3),
        ]  # fmt: skip
    observed = accumulate(hits, [PATH])
    assert reactions(observed) == ([5 * MS] * 100, 0)
    (path,) = of_kind(observed, PATHS)
    assert path.identity == {"path": "/scan,/objects,/cmd", "publisher": "/driver"}
    # Without the messages between, nothing is known.
    missing = [seen_hit for seen_hit in hits if seen_hit.values.get("topic") != "/objects" or seen_hit.event != "take"]
    observed = accumulate(missing, [PATH])
    assert reactions(observed) == ([], 100)
    assert of_kind(observed, PATHS)[0].remarks == ("path unknown: 100 % of 100 messages at its end",)


def test_a_gap_ends_what_was_begun():
    missed = gap(0, 0)._replace(from_ns=215, until_ns=218)
    observed = accumulate([A[0], B[0], begin(210), missed, out(220), end(240)])
    assert reactions(observed) == ([], 1)
    (messages,) = of_kind(observed, MESSAGES)
    assert "callback_end_ns" not in messages.columns


def test_ends_of_callbacks_stand_beside_their_messages():
    hits = [*A, B[0], begin(210), end(240), B[1]]
    (messages,) = of_kind(accumulate(hits), MESSAGES)
    assert messages.columns["callback_end_ns"].tolist() == [240, NOT_SEEN_NS]


def test_which_message_a_callback_of_roscpp_is_about_is_not_known():
    """Another thread took it, and no probe tells where the callback ends."""
    start, payload = 11 * S, (1, 2, 30)
    hits = [
        publish_bytes(start, payload, "/scan"), take_bytes(start + 100, payload, "/scan", tid=7),
        begin(start + 200, topic="/scan"), publish_bytes(start + 210, (9, 9, 40), "/objects", pid=2, endpoint=OBJECTS),
    ]  # fmt: skip
    observed = accumulate(hits)
    assert reactions(observed) == ([], 1) and of_kind(observed, CALLBACK) == []


def test_callbacks_are_named_by_their_beginning():
    """As rclcpp makes a subscription and a timer."""
    hits = [
        event(0, "node_init", node=2, name="leg", namespace="/"),
        event(1, "node_init", node=1, name="arm", namespace="/"),
        event(2, "subscription_init", subscription=10, node=1, endpoint=0xB0, topic="/scan", depth=1),
        event(3, "subscription_linked", subscription=10, object=20), event(4, "callback_added", object=20, callback=30),
        event(5, "timer_init", timer=40, period_ns=MS), event(6, "timer_callback_added", timer=40, callback=50),
        event(7, "timer_linked", timer=40, node=1),
        begin(8, 30), end(9, 30),
    ]  # fmt: skip
    for at_ns in range(MS, 5 * MS, MS):
        hits += [event(at_ns, "timer_call", timer=40), begin(at_ns + 1, 50), end(at_ns + 4, 50)]
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([])
    observed.observe([node(2, "detector")])
    observed.feed(hits)
    callbacks = of_kind(observed, CALLBACK)
    found = [
        (*stream.identity.values(), (stream.columns["end_ns"] - stream.columns["begin_ns"]).tolist())
        for stream in callbacks
    ]
    assert found == [("/arm", "/scan", 1, [1]), ("/arm", "timer 1 ms", 1, [3] * 4)]


def test_durations_by_callback_and_thread():
    hits = []
    for start in range(0, 100 * MS, 10 * MS):
        thread = 20 + start // (10 * MS) % 2
        hits += [
            sent(start), got(start + MS, start, tid=thread), begin(start + MS + 1, tid=thread),
            end(start + 2 * MS + thread, tid=thread),
            event(start + 3 * MS, "timer_call", tid=22, timer=0xC0, period_ns=10 * MS),
            begin(start + 3 * MS + 1, 0xF1, tid=22), end(start + 3 * MS + 500, 0xF1, tid=22),
            begin(start + 4 * MS, 0xF2), end(start + 4 * MS + 9, 0xF2),
        ]  # fmt: skip
    recorder = FlowRecorder(25)
    callbacks = of_kind(accumulate(hits, recorder=recorder), CALLBACK)
    found = {
        (stream.identity["callback"], stream.identity["thread"]): set(
            (stream.columns["end_ns"] - stream.columns["begin_ns"]).tolist()
        )
        for stream in callbacks
    }
    assert found == {
        ("/scan", 1): {MS + 19},
        ("/scan", 2): {MS + 20},
        ("timer 10 ms", 1): {499},
        ("unknown", 1): {9},
    }
    assert sum(stream.counts["measured"] for stream in callbacks) == 30
    assert len(recorder.messages) + len(recorder.callbacks) == 25 and recorder.left_out == 15


@pytest.mark.parametrize(
    ("argv", "label"),
    [
        (["/opt/talker", "--ros-args", "-r", "__node:=chatty", "-r", "__ns:=/front"], "/front/chatty"),
        (["/opt/talker", "--ros-args", "-r", "__ns:=/front"], "/front/talker"),
        (["/opt/talker", "--ros-args", "--remap", "talker:__node:=chatty"], "/chatty"),
        (["/opt/talker", "__name:=chatty", "__log:=/x"], "/chatty"),
        (["/opt/container", "a:__node:=one", "b:__node:=two"], "container"),
        (["/usr/bin/python3", "-u", "/opt/lib/talker.py", "x"], "talker.py"),
        (["python3.11", "-m", "package.talker"], "package.talker"),
        (["./bin/talker", "x:=y"], "talker"),
        (["python3"], "python3"),
        ([], "comm"),
    ],
)
def test_names_of_programs(argv, label):
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([program(1, argv)])
    observed.feed([publish(1)])
    assert next(streams(observed)).identity["node"] == label


def test_a_thread_of_an_unknown_process_is_one_of_the_process_that_is_known_by_other_means():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "lidar", threads=[(1, "lidar"), (11, "timer")]), node(2, "detector")])
    unknown = [sent(10, tid=11), sent(20, "/by_hits", 2, 0xA1), sent(30, "/by_hits", 2, 0xA1), sent(40, "/a", tid=99)]
    observed.feed(
        publication._replace(pid=0) if place != 1 else publication for place, publication in enumerate(unknown)
    )
    found = [(stream.identity["node"], stream.counts["messages"]) for stream in streams(observed)]
    assert found == [("/lidar", 1), ("/detector", 2), ("process of thread 99", 1)]


def test_the_last_hits_of_a_program_that_has_ended_are_still_its_own():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "lidar", threads=[(1, "lidar")])])
    observed.feed([sent(10)])
    observed.observe([])
    observed.feed([sent(20)])
    observed.observe([])
    observed.observe([node(7, "lidar")])
    observed.feed([sent(30, pid=7)])
    (stream,) = streams(observed)
    assert stream.counts["messages"] == 3 and stream.cuts.tolist() == [2]


def test_the_last_hits_of_a_program_are_its_own_though_it_ended_before_they_come():
    """With the kernel's trace a round takes long: the end is listed before the last hits, with another's begin."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "lidar")])
    observed.feed([sent(10)])
    observed.observe([])
    observed.feed([sent(20)])
    observed.observe([node(7, "lidar", start_ticks=200)])
    observed.feed([sent(30), sent(40, pid=7)])
    (stream,) = streams(observed)
    assert stream.identity["node"] == "/lidar" and stream.counts["messages"] == 4


def twin(pid, topic, *more, start_ticks=100):
    argv = ("/opt/lib/relay", "--ros-args", "-r", "__node:=relay", "-r", f"in:={topic}", *more)
    return program(pid, argv, start_ticks=start_ticks)


@pytest.mark.parametrize(
    ("first", "second", "again", "expected"),
    [
        ((), (), [("/a", ()), ("/b", ())], {"/relay": 15, "/relay#2": 30}),
        # As a launch file starts them: each with a file of its own.
        (("--params-file", "/tmp/1"), ("--params-file", "/tmp/2"),
         [("/a", ("--params-file", "/tmp/3")), ("/b", ("--params-file", "/tmp/4"))], {"/relay": 15, "/relay#2": 30}),
        # Neither is more like one than like the other.
        ((), (), [("/c", ()), ("/d", ())], {"/relay": 10, "/relay#2": 20, "/relay#3": 10, "/relay#4": 5}),
    ],
)  # fmt: skip
def test_programs_of_one_name_stay_apart_when_they_begin_again_in_another_order(first, second, again, expected):
    (topic_a, more_a), (topic_b, more_b) = again
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([twin(1, "/a", *first), twin(2, "/b", *second, start_ticks=101)])
    observed.feed([*(sent(at, pid=1) for at in range(10)), *(sent(at, pid=2) for at in range(20))])
    observed.observe([])
    observed.feed([])
    observed.observe([twin(8, topic_b, *more_b, start_ticks=200), twin(7, topic_a, *more_a, start_ticks=201)])
    observed.feed([*(sent(at, pid=7) for at in range(100, 105)), *(sent(at, pid=8) for at in range(90, 100))])
    found = {stream.identity["node"]: stream.counts["messages"] for stream in streams(observed)}
    assert found == expected


def test_callbacks_within_one_another_beyond_64_were_left_by_exceptions():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(2, "detector")])
    observed.feed([begin(MS * k, callback=k) for k in range(1, 65)])
    thread = observed._programs.thread(2, 2)
    assert len(thread.callbacks) == 64
    observed.feed([begin(MS * 65, callback=65)])
    assert [callback.begin_ns for callback in thread.callbacks] == [MS * 65]
