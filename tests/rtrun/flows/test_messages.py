"""Messages of a system whose every message is known: the report about each is true, and the numbers add up."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from made_flows import (
    BEGIN_NS,
    MS,
    WALL_NS,
    S,
    System,
    gap,
    hit,
    listener,
    node,
    program,
    publish,
    publish_bytes,
    take,
    take_bytes,
    talker,
)  # fmt: skip

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.interval import STREAM as INTERVAL
from rtrun.kinds.messages import STREAM as MESSAGES

PAIR = {"topic": "/a", "publisher": "/talker", "subscriber": "/listener"}


def messages(observed):
    """The streams of messages by the labels of their ends."""
    pairs = [stream for stream in streams(observed) if stream.kind is MESSAGES]
    return {(stream.identity["publisher"], stream.identity["subscriber"]): stream for stream in pairs}


def ends(observed):
    intervals = [stream for stream in streams(observed) if stream.kind is INTERVAL]
    return {(stream.identity["end"], stream.identity["node"]): stream for stream in intervals}


def check(observed, truth, *, is_complete=True):
    """Every row is a true message, nothing that came counts as lost, and the numbers add up."""
    received = Counter()
    for pair, stream in messages(observed).items():
        taken, counts = truth.taken[pair], stream.counts
        published_ns, reception_ns, seq = (stream.columns[key] for key in ("publication_ns", "reception_ns", "seq"))
        rows = list(zip(published_ns.tolist(), reception_ns.tolist(), strict=True))
        assert all(taken_ns == taken[at_ns][0] for at_ns, taken_ns in rows), "a row that is no message"
        assert len({at_ns for at_ns, _ in rows}) == len(rows) == counts["received"]
        assert np.all(np.diff(reception_ns) >= 0)
        assert counts["out_of_order"] == np.count_nonzero(np.diff(published_ns) < 0)
        total = counts["received"] + counts["lost"] + counts["ambiguous"] + counts["undecided"]
        assert total == counts["published"] == len(truth.published[pair[0]])
        assert min(counts.values()) >= 0
        # What is missing between the numbers is what was lost, for whoever reads the columns alone.
        order = np.argsort(published_ns)
        assert np.all(np.diff(seq[order]) >= 1) and (not rows or seq.min() == 0)
        assert (seq.max() + 1 if rows else 0) - len(rows) == counts["lost"]
        # One that was overtaken by the end may still be on its way.
        late_ns = int((reception_ns - published_ns).max(initial=0))
        decided_ns = int(reception_ns.max(initial=0)) - late_ns
        never = [at_ns for at_ns in truth.published[pair[0]] if not taken.get(at_ns) and at_ns <= decided_ns]
        gone = sum(np.searchsorted(np.sort(published_ns), at_ns) not in (0, len(rows)) for at_ns in never)
        assert counts["lost"] <= gone
        received[pair[1]] += counts["received"]
        if stream.open_ns:
            untaken = [at_ns for at_ns in truth.published[pair[0]] if at_ns >= observed.until_ns - stream.open_ns]
            assert untaken[0] == observed.until_ns - stream.open_ns
            assert not any(taken.get(at_ns) for at_ns in untaken), "it was taken"
        if is_complete:
            seen = set(truth.published[pair[0]])
            of_both = {at_ns: times[0] for at_ns, times in taken.items() if at_ns in seen}
            assert dict(rows) == of_both and counts["lost"] == gone
    for (role, label), stream in ends(observed).items():
        counts = stream.counts
        if role == "subscriber":
            assert counts["received"] == received[label]
            decided = ("received", "duplicate", "ambiguous", "historic", "unmatched", "waiting")
            assert sum(counts[key] for key in decided) == counts["messages"] == truth.takes[label]
            assert counts["waiting"] == 0
        else:
            assert counts["messages"] == len(truth.published[label])


def test_stamped_messages_that_are_lost_doubled_delayed_and_reordered():
    system = System([talker(), listener()], loss=0.05, doubled=0.03, slow=0.02, latency_ns=5 * MS)
    observed, truth = system.observe()
    check(observed, truth)
    counts = messages(observed)["/talker", "/listener"].counts
    assert min(counts[key] for key in ("lost", "duplicate", "out_of_order", "undecided")) > 0
    # Published before the begin, taken after it.
    assert ends(observed)["subscriber", "/listener"].counts["unmatched"] == sum(
        len(times)
        for at_ns, times in truth.taken["/talker", "/listener"].items()
        if at_ns not in truth.published["/talker"]
    )


def test_stamps_that_differ_by_rounding():
    check(*System([talker(), listener()], stamp_error_ns=2).observe())


def test_several_publishers_and_subscribers_of_a_topic():
    lives = [talker(), talker("/other", 3, period_ns=7 * MS), listener(), listener("/logger", 4)]
    observed, truth = System(lives, loss=0.02, slow=0.01).observe()
    check(observed, truth)
    assert len(messages(observed)) == 4


def test_what_no_publication_is_known_of_is_said_once_for_a_subscriber():
    """Not for each of its pairs: nobody knows whose it is."""
    observed = FlowAccumulator(begin_ns=0)
    sent = [publish(10 * pid, pid=pid, endpoint=pid) for pid in (1, 3)]
    observed.feed([*sent, take(100, 10), take(101, 30), take(102, 5)])
    remarked = [(stream.kind, stream.identity, stream.remarks) for stream in streams(observed) if stream.remarks]
    assert len(messages(observed)) == 2 and len(remarked) == 1
    ((kind, identity, (remark,)),) = remarked
    assert (kind, identity["end"], identity["topic"]) == (INTERVAL, "subscriber", "/a")
    assert remark.startswith("1 message came whose publication was not seen, of whatever publisher: ")


def test_a_program_that_restarts_is_measured_on():
    """With its pointers, and with its pid: only the start of the process tells."""
    half = BEGIN_NS + 10 * S
    lives = [
        talker(until_ns=half),
        talker(from_ns=half + 2 * S, start_ticks=1300),
        listener(until_ns=half + 5 * S),
        listener(pid=9, from_ns=half + 6 * S, start_ticks=1900),
    ]
    observed, truth = System(lives, loss=0.05).observe()
    check(observed, truth, is_complete=False)
    (stream,) = messages(observed).values()
    assert dict(stream.identity) == PAIR
    times = stream.columns["reception_ns"]
    assert times.min() < half < half + 2 * S < times.max()
    # Nobody was there for 100 messages: they are not lost.
    assert stream.counts["undecided"] > 90
    assert 0.02 < stream.counts["lost"] / stream.counts["published"] < 0.08
    # The time between the last message before the restart and the first one after it is no interval.
    publisher = ends(observed)["publisher", "/talker"]
    assert np.diff(publisher.columns["timestamp_ns"])[publisher.cuts - 1].max() > S


def test_what_ros_sends_for_itself_is_no_stream():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "camera"), node(2, "base")])
    for topic in ("/a", "ros_discovery_info", "/parameter_events"):
        observed.feed([publish(observed.newest_ns + 1, topic)])
        observed.feed([take(observed.newest_ns + 1, observed.newest_ns, topic)])
    assert {end.topic for end in observed.topics.ends.values()} == {"/a"} and not observed.state.unreadable


def test_a_program_has_one_name_on_all_topics():
    """The second of two by one name is the second everywhere, also where it is alone."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "camera"), node(2, "camera")])
    observed.feed([publish(1), publish(2, pid=2, endpoint=1), publish(3, "/b", pid=2, endpoint=2)])
    observed.feed([publish(4, "/b", pid=2, endpoint=3)])
    assert {(end.topic, end.label) for end in observed.topics.ends.values()} == {
        ("/a", "/camera"), ("/a", "/camera#2"), ("/b", "/camera#2"), ("/b", "/camera#2 (2)")
    }  # fmt: skip
    assert observed.state.pids["/camera#2"] == observed.state.pids["/camera#2 (2)"] == {2}


@pytest.mark.parametrize("heard_first", [1, 2])
def test_of_two_programs_of_one_name_the_first_is_the_one_that_began_first(heard_first):
    """In each run the same, so that runs of one stream are pooled and no others."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "camera", start_ticks=20), node(2, "camera", start_ticks=10)])
    observed.feed([publish(1, f"/of_{heard_first}", pid=heard_first)])
    observed.feed([publish(2, f"/of_{3 - heard_first}", pid=3 - heard_first)])
    labels = {(end.topic, end.label) for end in observed.topics.ends.values()}
    assert labels == {("/of_1", "/camera#2"), ("/of_2", "/camera")}


def silent_at_the_end(*, living=(1, 2), cut_at_ns=None):
    """A talker that sends for a second, and then never again, while another program goes on."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker"), node(2, "other")])
    observed.feed([publish(n * 10 * MS) for n in range(1, 100)])
    for _ in range(2):
        observed.observe([node(pid, name) for pid, name in ((1, "talker"), (2, "other")) if pid in living])
    if cut_at_ns:
        observed.feed([gap(0, 0)._replace(from_ns=cut_at_ns, until_ns=cut_at_ns + 1)])
    observed.feed([publish(30 * S, "/b", pid=2, endpoint=0xC0)])
    observed.finish(60 * S)
    return ends(observed)["publisher", "/talker"].open_ns


def test_a_publisher_that_hangs_for_good_has_a_stall():
    assert silent_at_the_end() == 60 * S - 990 * MS
    # Of one that ended, and where hits are missing, nothing is known.
    assert silent_at_the_end(living=(2,)) == silent_at_the_end(cut_at_ns=2 * S) == 0


def test_two_programs_of_one_name_are_told_apart():
    lives = [talker(), listener(), listener(pid=5)]
    observed, _ = System(lives).observe()
    assert set(messages(observed)) == {("/talker", "/listener"), ("/talker", "/listener#2")}


def test_nothing_is_joined_across_a_gap():
    system = System([talker(), listener()], latency_ns=30 * MS)
    cut = gap(7, 9)
    observed, truth = system.observe([cut])
    check(observed, truth, is_complete=False)
    columns = messages(observed)["/talker", "/listener"].columns
    across = (columns["publication_ns"] < cut.from_ns) & (columns["reception_ns"] >= cut.until_ns)
    assert not across.any() and len(columns["seq"]) > 1500
    # What was on its way is not lost.
    assert messages(observed)["/talker", "/listener"].counts["lost"] == 0
    assert ends(observed)["publisher", "/talker"].cuts.size == 1


def test_hits_within_a_gap_and_late_ones_are_left_out():
    observed = FlowAccumulator(begin_ns=0)
    observed.feed([publish(10), take(20, 10), gap(0, 1)._replace(from_ns=100, until_ns=200), publish(150)])
    assert observed.in_gaps == 1
    observed.feed([publish(300), take(310, 300)])
    observed.feed([publish(305), take(320, 305)])
    assert observed.gaps[-1].from_ns == 305 and observed.gaps[-1].until_ns == 310
    observed.finish()
    (stream,) = messages(observed).values()
    assert stream.columns["reception_ns"].tolist() == [20, 310]
    assert stream.counts["lost"] == 0


@pytest.mark.parametrize("loss", [0, 0.05])
def test_payloads_that_differ(loss):
    system = System([talker(payloads=10**9), listener()], is_ordered=True, loss=loss, latency_ns=5 * MS)
    system.until_ns = BEGIN_NS + 21 * S  # what comes in the first ten seconds is decided after them
    check(*system.observe())


@pytest.mark.parametrize("is_told", [False, True])
def test_payloads_that_begin_with_their_time_are_matched_at_once(is_told):
    """roscpp writes the number of a message with a header after the probe saw it."""
    observed = FlowAccumulator(begin_ns=BEGIN_NS)
    if is_told:
        observed.offset("system", BEGIN_NS, WALL_NS)
    for number in range(100):
        at_ns = BEGIN_NS + number * MS
        second, nanosecond = divmod(at_ns + WALL_NS, S)
        sent, came = ((first + (second << 32), nanosecond, 100) for first in (0, number))
        observed.feed([publish_bytes(at_ns, sent), take_bytes(at_ns + 5, came)])
        # On the clock of the hits, without a number in front.
        second, nanosecond = divmod(at_ns, S)
        own = second + (nanosecond << 32), number, 100
        observed.feed([publish_bytes(at_ns + 10, own, "/b", endpoint=1), take_bytes(at_ns + 20, own, "/b", endpoint=1)])
    observed.finish()
    counts = {stream.identity["topic"]: stream.counts for stream in streams(observed) if stream.kind is MESSAGES}
    assert counts["/a"]["received"] == 100 * is_told and counts["/b"]["received"] == 100


@pytest.mark.parametrize("latency_ns", [MS, 15 * MS, 40 * MS])
def test_the_same_payload_of_a_program_that_ran_before_is_never_guessed(latency_ns):
    """A message of before the begin may be on its way all the time: what is taken is then never what is just sent."""
    system = System([talker(payloads=1), listener()], is_ordered=True, latency_ns=latency_ns)
    observed, truth = system.observe()
    check(observed, truth, is_complete=False)
    assert messages(observed)["/talker", "/listener"].counts["ambiguous"] > 1900


def test_the_same_payload_is_matched_from_its_first_message_to_its_first_loss():
    starts = BEGIN_NS + 11 * S
    for loss, latency_ns, least in ((0, 15 * MS, 0.95), (0.02, MS, 0.001)):
        system = System(
            [talker(payloads=1, from_ns=starts), listener()], is_ordered=True, loss=loss, latency_ns=latency_ns,
            until_ns=starts + 9 * S,
        )  # fmt: skip
        observed, truth = system.observe()
        check(observed, truth, is_complete=False)
        counts = messages(observed)["/talker", "/listener"].counts
        assert counts["received"] >= least * counts["published"]
        # Without a loss only what was on its way at the end.
        assert (counts["ambiguous"] > 100) == (loss > 0)


def test_a_payload_of_two_publishers_is_not_told_apart():
    starts = BEGIN_NS + 11 * S
    lives = [talker(payloads=1, from_ns=starts), talker("/other", 3, payloads=1, from_ns=starts), listener()]
    observed, truth = System(lives, is_ordered=True, latency_ns=25 * MS, until_ns=starts + 5 * S).observe()
    check(observed, truth, is_complete=False)
    assert ends(observed)["subscriber", "/listener"].counts["ambiguous"] > 100


@pytest.mark.parametrize(
    ("seen", "pairs", "ambiguous"),
    [
        ("p0 p1 t2 t3", [(0, 2), (1, 3)], 0),
        ("p0 q1 t2 t3", [], 2),  # which of the two came first is not known
        ("p0 t1 q2 t3", [(0, 1), (2, 3)], 0),
        ("p0 t1 t2 p3 t4", [(0, 1)], 1),  # of the second one nobody saw the publication: there may be more
        ("t0 p1 t2", [], 1),
        ("p0 p1 t2 p900 p1001 t1002", [], 2),  # after a loss any of the open ones may come
        ("p0 p1 t2 p900 t2200 p3300 t3301", [(3300, 3301)], 1),  # until it was quiet for long
        ("p0 p900 t1100", [(900, 1100)], 0),  # what was published too long ago is not on its way
    ],
)
def test_the_same_bytes_in_short(seen, pairs, ambiguous):
    """Publications of two publishers and receptions, by their time; nothing is on its way for more than 1000 ns."""
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    for word in seen.split():
        at_ns = 5000 + int(word[1:])
        payload = (1, 2, 30)
        observed.feed(
            [take_bytes(at_ns, payload) if word[0] == "t" else publish_bytes(at_ns, payload, pid=ord(word[0]))]
        )
    observed.finish()
    rows = []
    for stream in messages(observed).values():
        columns = (stream.columns[key] - 5000 for key in ("publication_ns", "reception_ns"))
        rows += zip(*(column.tolist() for column in columns), strict=True)
    assert sorted(rows) == pairs
    assert ends(observed)["subscriber", "process 2"].counts["ambiguous"] == ambiguous


@pytest.mark.parametrize(
    ("seen", "pairs", "historic"),
    [
        ("p0 s900 t901", [], 1),  # latched: given to a subscriber that came later
        ("p0 t1 s900 t901", [(0, 1)], 1),  # and again to one that comes back
        ("p0 t1 s900 t901 s950 t951 p960 t961", [(0, 1), (960, 961)], 2),
        ("p0 p1 t2 s900 t901", [], 1),  # of the first one it was not known which it was
        ("p0 q1 s900 t901", [], 1),  # whichever it was
        ("s900 p901 t960", [(901, 960)], 0),
        ("p0 t1 s900 p901 t902", [(0, 1), (901, 902)], 0),
        ("p0 s1500 t1501", [], 0),  # too long ago to be known
    ],
)
def test_what_a_latched_topic_gives_to_a_subscriber_that_came_later_has_no_latency(seen, pairs, historic):
    """As above, and subscriptions that are made."""
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    for word in seen.split():
        at_ns, payload = 5000 + int(word[1:]), (1, 2, 30)
        inits = {
            "s": hit(at_ns, "subscription_init", pid=2, endpoint=0xB0, topic="/a"),
            "t": take_bytes(at_ns, payload),
        }
        observed.feed([inits.get(word[0]) or publish_bytes(at_ns, payload, pid=ord(word[0]))])
    observed.finish()
    rows = []
    for stream in messages(observed).values():
        columns = (stream.columns[key] - 5000 for key in ("publication_ns", "reception_ns"))
        rows += zip(*(column.tolist() for column in columns), strict=True)
    assert sorted(rows) == pairs
    counts = ends(observed)["subscriber", "process 2"].counts
    assert counts["historic"] == historic
    assert counts["messages"] == seen.count("t") == sum(counts.values()) - counts["messages"]


def test_what_could_not_be_told_apart_is_named_by_what_was_compared():
    """Of bytes the first twelve and the length, which is not all of them; or the time stamps."""
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    payload = (1, 2, 30)
    bytes_of_two = [publish_bytes(5000 + pid, payload, pid=pid) for pid in (1, 3)]
    stamps_of_two = [publish(6000 + pid, "/b", pid=pid, endpoint=pid, stamp=7) for pid in (1, 3)]
    observed.feed([*bytes_of_two, take_bytes(5010, payload), take_bytes(5011, payload)])
    observed.feed([*stamps_of_two, take(6010, 7 - WALL_NS, "/b", endpoint=0xB1)])
    observed.finish()
    pairs = [stream for stream in streams(observed) if stream.kind is MESSAGES]
    assert {(stream.identity["topic"], stream.remarks) for stream in pairs} == {
        (topic, (f"not known of 1 publication whether they came: other messages have the same {compared}",))
        for topic, compared in (("/a", "first 12 bytes and length"), ("/b", "time stamp"))
    }


@pytest.mark.parametrize(("unlike", "pairs"), [(99, []), (100, [(0, 1)])])
def test_of_the_first_bytes_after_the_begin_nobody_knows_unless_their_publisher_does_not_repeat_itself(unlike, pairs):
    """The same may have been published before, and this one be lost."""
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    payloads = [(number + (7 << 32), 7, 30) for number in range(unlike)]
    observed.feed([publish_bytes(0, payloads[0]), take_bytes(1, payloads[0])])
    observed.feed(publish_bytes(10 + number, payload) for number, payload in enumerate(payloads[1:]))
    observed.feed([publish(5000, "/b", pid=2, endpoint=0xC0)])
    rows = [
        (int(sent), int(taken))
        for stream in messages(observed).values()
        for sent, taken in zip(stream.columns["publication_ns"], stream.columns["reception_ns"], strict=True)
    ]
    assert rows == pairs
    assert ends(observed)["subscriber", "process 2"].counts["ambiguous"] == 1 - len(pairs)


def test_what_lies_behind_a_short_payload_does_not_count():
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    observed.feed(
        [
            # Passed on within its process, by its pointer.
            hit(1900, "publish", endpoint=0xA0, topic="/a", key0=0, key1=0),
            publish_bytes(2000, (0xFFFFFF05, 0x1111, 1)),
            take_bytes(2100, (0xEEEEEE05, 0x2222, 1)),
            publish_bytes(2200, (5, 0x33445566, 10)),
            take_bytes(2300, (5, 0x77885566, 10)),
        ]
    )
    observed.finish()
    (stream,) = messages(observed).values()
    assert stream.columns["reception_ns"].tolist() == [2100, 2300] and stream.counts["published"] == 2


def test_stamps_of_two_publishers_that_cannot_be_told_apart():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker"), node(3, "other"), node(2, "listener")])
    observed.feed([publish(100, stamp=50), publish(101, stamp=51, pid=3), take(200, 50 - 1_700_000_000 * S)])
    observed.feed([publish(300), publish(350, pid=3), take(400, 300), take(500, 310)])
    observed.finish()
    counts = messages(observed)["/talker", "/listener"].counts
    assert (counts["received"], counts["ambiguous"], counts["lost"]) == (1, 1, 0)
    observed.feed([publish(600), take(700, 600), publish(800), publish(801, pid=3), take(900, 800)])
    observed.feed([publish(1000), publish(1100), take(1200, 1100)])
    counts = messages(observed)["/talker", "/listener"].counts
    assert (counts["received"], counts["ambiguous"], counts["lost"]) == (3, 2, 1)
    assert messages(observed)["/talker", "/listener"].columns["seq"].tolist() == [0, 1, 3]


def test_what_a_restarted_subscriber_takes_late_counts_once():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(2, "listener")])
    observed.feed([*map(publish, (100, 110, 120, 130, 140)), take(200, 100), take(210, 120)])
    observed.observe([node(2, "listener", start_ticks=9)])
    observed.feed([take(300, 110), take(310, 120), take(320, 140)])
    (stream,) = messages(observed).values()
    assert stream.columns["publication_ns"].tolist() == [100, 120, 110, 140]
    assert stream.columns["seq"].tolist() == [0, 2, 1, 4]
    assert (stream.counts["lost"], stream.counts["duplicate"], stream.counts["out_of_order"]) == (1, 1, 1)


def test_messages_published_before_a_subscription_was_made_have_no_latency():
    observed = FlowAccumulator(begin_ns=0)
    init = hit(1000, "subscription_init", pid=2, endpoint=0xB0, node=1, topic="/a", depth=1)
    observed.feed([publish(100), init, take(1100, 100), publish(1200), take(1300, 1200)])
    observed.finish()
    (stream,) = messages(observed).values()
    assert stream.columns["publication_ns"].tolist() == [1200]
    assert ends(observed)["subscriber", "process 2"].counts["historic"] == 1


def test_nodes_are_named_by_their_beginning():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([])
    observed.observe([node(1, "container")])
    observed.feed(
        [
            hit(1, "node_init", node=7, name="camera", namespace="/front"),
            hit(2, "publisher_init", endpoint=0xA0, node=7, topic="/a", depth=1),
            publish(3),
            hit(4, "node_init", node=9, name="other", namespace="/"),
            hit(5, "publisher_init", endpoint=0xA0, node=8, topic="/b", depth=1),
            publish(6, "/b"),
            publish(7, "/c"),
        ]
    )
    found = [(stream.identity["topic"], stream.identity["node"]) for stream in streams(observed)]
    assert found == [("/a", "/front/camera"), ("/b", "/container"), ("/c", "/container")]


def test_a_program_that_ran_before_keeps_its_name_when_its_node_is_seen_to_begin():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([program(1)])
    observed.feed([publish(1)])
    observed.observe([program(2)])
    begun = [
        hit(2, "node_init", pid=2, node=7, name="chatty", namespace="/"),
        hit(3, "publisher_init", pid=2, endpoint=5, node=7, topic="/a", depth=1),
    ]
    observed.feed([*begun, publish(4, pid=2, endpoint=5)])
    assert ends(observed)["publisher", "talker"].counts["messages"] == 2


def test_hits_that_cannot_be_read_are_counted():
    observed = FlowAccumulator(begin_ns=0)
    observed.feed(
        [
            publish(1, "(fault)"),
            hit(3, "take", endpoint=1, topic="/a", taken=1),
            hit(4, "timer_call"),
            hit(5, "callback_begin"),
            hit(6, "subscription_init", node=1),
            hit(7, "node_init", node=1, name="(fault)"),
            hit(8, "timer_linked", timer=5, node=1),
            hit(9, "callback_added"),
            hit(10, "callback_end"),
        ]
    )
    assert observed.state.unreadable == 8
    assert messages(observed) == {}


def unstamped(at_ns, pid=1, topic="/a"):
    return hit(at_ns, "publish", pid=pid, endpoint=0xA0, topic=topic)


def test_a_stamp_that_is_not_seen_lies_within_its_publication():
    """As in Humble, whose trace point has no stamp."""
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker"), node(3, "other"), node(2, "listener")])
    # How the clock stands is not known yet.
    observed.feed([unstamped(100), take(150, 110)])
    observed.offset("system", 200, WALL_NS)
    # One message for two subscribers; then one of a publisher that is not observed, while the thread does nothing.
    observed.feed([unstamped(1000), take(1100, 1010), take(1150, 1010, pid=4, endpoint=0xB4), take(1500, 1400)])
    # The thread went on before the stamp was taken.
    observed.feed([unstamped(2000), hit(2020, "callback_end", callback=1), take(2100, 2030)])
    # Two at the same time; the second one has begun after the stamp.
    observed.feed([unstamped(3000), unstamped(3011, 3), take(3100, 3010), take(3200, 3020)])
    # What the other one published long before, and nobody took, is not it.
    observed.feed([unstamped(4 * MS, 3), unstamped(8 * MS), take(8 * MS + 100, 8 * MS + 10)])
    # A thread that had to wait for a CPU before it took the stamp.
    observed.feed([unstamped(20 * MS), take(51 * MS, 50 * MS)])
    observed.finish()
    pairs = messages(observed)
    columns = pairs["/talker", "/listener"].columns
    assert columns["publication_ns"].tolist() == [1000, 3000, 8 * MS, 20 * MS]
    assert columns["reception_ns"].tolist() == [1100, 3100, 8 * MS + 100, 51 * MS]
    assert pairs["/other", "/listener"].columns["publication_ns"].tolist() == [3011]
    assert pairs["/talker", "process 4"].columns["publication_ns"].tolist() == [1000]
    assert pairs["/talker", "/listener"].counts["lost"] == 1 and pairs["/talker", "/listener"].remarks == ()
    taken = ends(observed)["subscriber", "/listener"].counts
    assert (taken["received"], taken["unmatched"], taken["ambiguous"]) == (5, 3, 0)


def test_stamps_within_two_publications():
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker"), node(3, "other"), node(2, "listener")])
    observed.offset("system", 0, WALL_NS)
    observed.feed([unstamped(1000), unstamped(1005, 3), take(1100, 1010), take(1200, 1011), take(1300, 1012)])
    # The clock is set back: what was published before that is not known by its stamp any more, nor is it lost.
    observed.feed([unstamped(20 * MS)])
    observed.offset("system", 25 * MS, WALL_NS - 10 * MS)
    observed.feed([take(26 * MS, 10 * MS + 10), unstamped(30 * MS), take(31 * MS, 20 * MS + 10)])
    observed.finish()
    stream = messages(observed)["/talker", "/listener"]
    assert stream.columns["publication_ns"].tolist() == [30 * MS] and stream.counts["ambiguous"] == 1
    assert stream.remarks == (
        "not known of 1 publication whether they came: other messages have the same time of publication",
    )
    assert ends(observed)["subscriber", "/listener"].counts["ambiguous"] == 3


@pytest.mark.parametrize(
    ("before", "at_s", "open_s"), [("deactivating", 1, 0), ("deactivating", 9, 8), ("configuring", 9, 59)]
)
def test_silence_is_a_stall_until_a_node_is_deactivated(before, at_s, open_s):
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker")])
    observed.feed([publish(call * 10 * MS) for call in range(101)])
    observed.feed([hit(at_s * S + 1, "lifecycle", before=before, after="inactive")])
    observed.finish(60 * S)
    open_ns = ends(observed)["publisher", "/talker"].open_ns
    assert round(open_ns / S) == open_s


def test_names_that_are_alike_when_printed_stay_two():
    observed = FlowAccumulator(begin_ns=0)
    observed.feed([publish(1, "/\x1b"), publish(2, "/\x1c", endpoint=2)])
    identities = [tuple(stream.identity.items()) for stream in streams(observed)]
    assert len(set(identities)) == 2 and all(
        str(value).isprintable() for identity in identities for _, value in identity
    )


def test_unmatched_publications_are_forgotten_after_the_horizon():
    observed = FlowAccumulator(begin_ns=0, horizon_ns=1000)
    observed.feed([publish(at_ns) for at_ns in range(0, 100_000, 10)])
    assert ends(observed)["publisher", "process 1"].counts["never_taken"] == 9899
    assert sum(len(matching._open) for matching in observed.topics._matchings()) <= 101


def ds(tenths):
    """So many tenths of a second after the begin."""
    return BEGIN_NS + tenths * S // 10


@st.composite
def systems(draw):
    """Programs that begin and end at any time; those with payloads instead of stamps double nothing."""
    payloads = draw(st.sampled_from([0, 1, 2, 30, 10**9]))
    lives = []
    for pid in range(1, draw(st.integers(2, 5)) + 1):
        times = {
            "from_ns": ds(draw(st.integers(-20, 30))),
            "until_ns": ds(draw(st.integers(5, 50))),
        }
        if draw(st.booleans()):
            period_ns = draw(st.sampled_from([20, 50, 300])) * MS
            lives.append(talker(f"/talker{pid}", pid, payloads=payloads, period_ns=period_ns, **times))
        else:
            lives.append(listener(f"/listener{pid}", pid, **times))
    return System(
        lives,
        seed=draw(st.integers(0, 2**32)),
        loss=draw(st.sampled_from([0, 0.05, 0.5])),
        doubled=0 if payloads else draw(st.sampled_from([0, 0.1])),
        slow=draw(st.sampled_from([0, 0.1])),
        is_ordered=payloads > 0 or draw(st.booleans()),
        latency_ns=draw(st.sampled_from([MS // 10, 10 * MS, 100 * MS])),
        until_ns=ds(draw(st.integers(5, 50))),
    )


# Published in the gap, taken after it; the same bytes were published again, and lost.
IN_A_GAP_AND_AGAIN = System(
    [
        listener("/listener1", 1, from_ns=ds(0), until_ns=ds(17)),
        listener("/listener2", 2, from_ns=ds(24), until_ns=ds(36)),
        talker("/talker3", 3, payloads=30, period_ns=20 * MS, from_ns=ds(-14), until_ns=ds(16)),
        talker("/talker4", 4, payloads=30, period_ns=300 * MS, from_ns=ds(0), until_ns=ds(27)),
        talker("/talker5", 5, payloads=30, period_ns=20 * MS, from_ns=ds(21), until_ns=ds(31)),
    ],
    seed=29221,
    loss=0.5,
    slow=0.1,
    is_ordered=True,
    latency_ns=MS // 10,
    until_ns=ds(36),
)


@example(system=IN_A_GAP_AND_AGAIN, gaps=[(0, 4)], chunk_ns=S // 10)
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    system=systems(),
    gaps=st.lists(st.tuples(st.integers(0, 50), st.integers(1, 10)), max_size=2),
    chunk_ns=st.sampled_from([S // 10, S, 100 * S]),
)
def test_counts_always_add_up(system, gaps, chunk_ns):
    """Whatever programs begin, end and lose: every row is true, and each message is counted once."""
    observed, truth = system.observe(
        [gap(from_ds / 10, (from_ds + length_ds) / 10) for from_ds, length_ds in gaps],
        horizon_ns=3 * S,
        chunk_ns=chunk_ns,
    )
    check(observed, truth, is_complete=False)
