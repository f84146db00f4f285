"""Calls of services: each request has the answer that is its own, and who waits without one is overdue."""

import pytest
from made_flows import S, hit, node

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.kinds.rows import Stated
from rtrun.kinds.service import KIND, STREAM
from rtrun.probes.hits import Gap, GapCause

NAME = "/arm/grasp"


class Release:
    """The hits of one client and one server, as a release shows them: numbers everywhere, or where rmw has them."""

    def __init__(self, has_numbers, *, client=1, server=3, gid=7, has_gid=True):
        self.has_numbers, self.client, self.server = has_numbers, client, server
        self.gid = {"gid0": gid, "gid1": 0}
        self.own = self.gid if has_gid else {}

    def send(self, at_ns, number, before, *, seen_after=None):
        """With `seen_after` the number is seen later than that, as Fast DDS tells it."""
        sent = hit(at_ns, "request_send", pid=self.client, endpoint=0xC0, service=NAME, before=before, **self.own)
        numbered = hit(at_ns + (seen_after or 1), "request_number", pid=self.client, endpoint=0xC0, number=number)
        return [sent, numbered] if self.has_numbers else [sent]

    def take(self, at_ns, number, *, tid=None, taken=1):
        values = {**self.gid, "number": number, "taken": taken} if self.has_numbers else {}
        return [hit(at_ns, "request_take", pid=self.server, tid=tid, endpoint=0xD0, service=NAME, **values)]

    def answer(self, at_ns, number, *, tid=None):
        values = {**self.gid, "number": number}
        return [hit(at_ns, "response_send", pid=self.server, tid=tid, endpoint=0xD0, service=NAME, **values)]

    def receive(self, at_ns, number, *, taken=1):
        values = {"number": number, "taken": taken} if self.has_numbers else {}
        return [hit(at_ns, "response_take", pid=self.client, endpoint=0xC0, service=NAME, **values)]

    def call(self, at_ns, number, before):
        parts = self.take(at_ns + 10, number), self.answer(at_ns + 40, number), self.receive(at_ns + 60, number)
        return [*self.send(at_ns, number, before), *(seen_hit for part in parts for seen_hit in part)]


def accumulate(hits, until_ns=0):
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "planner"), node(2, "planner"), node(3, "arm")])
    observed.feed(hits)
    observed.finish(until_ns)
    return observed


def services(observed):
    return [stream for stream in streams(observed) if stream.kind is STREAM]


def rows(stream):
    return list(zip(*(stream.columns[name].tolist() for name in STREAM.columns), strict=True))


both = pytest.mark.parametrize("has_numbers", [True, False], ids=["Kilted", "before"])


@both
def test_a_call_has_its_parts(has_numbers):
    calls = Release(has_numbers)
    (stream,) = services(accumulate([*calls.call(100, 5, 4), *calls.call(200, 8, 5)]))
    assert dict(stream.identity) == {"service": NAME, "client": "/planner", "server": "/arm"}
    assert rows(stream) == [(100, 160, 110, 140), (200, 260, 210, 240)]
    stated = Stated(
        asked=2, measured=2, not_fired=0, missing=0, out_of_order=0, skipped=None, is_complete=True, requested={}
    )
    series = KIND.series(stream.columns, stated, None)
    assert {name: values.values_ns.tolist() for name, values in series.items()} == {
        "latency": [60, 60], "there": [10, 10], "work": [30, 30], "back": [20, 20],
    }  # fmt: skip


@both
def test_clients_with_the_same_numbers_have_their_own_answers(has_numbers):
    first, second = Release(has_numbers), Release(has_numbers, client=2, gid=8)
    hits = [
        *first.send(100, 1, 0), *second.send(101, 1, 0),
        # A look that finds nothing: the answer was the other client's.
        *second.take(110, 1), *second.answer(120, 1), *first.receive(125, 1, taken=0)[: has_numbers],
        *first.take(130, 1), *first.answer(140, 1), *second.receive(150, 1), *first.receive(170, 1),
    ]  # fmt: skip
    found = {stream.identity["client"]: rows(stream) for stream in services(accumulate(hits))}
    assert found == {"/planner": [(100, 170, 130, 140)], "/planner#2": [(101, 150, 110, 120)]}


@both
def test_requests_that_overlap(has_numbers):
    """The client sends before it has the answer; numbers of the middleware leave some out."""
    calls = Release(has_numbers)
    hits = [*calls.send(100, 3, 0), *calls.take(110, 3), *calls.send(120, 9, 3), *calls.answer(130, 3)]
    hits += [*calls.receive(140, 3), *calls.take(150, 9), *calls.answer(160, 9), *calls.receive(170, 9)]
    (stream,) = services(accumulate(hits))
    assert rows(stream) == [(100, 140, 110, 130), (120, 170, 150, 160)]


@both
def test_answers_that_wait_for_their_client(has_numbers):
    """Without numbers it is not known which of them it takes, nor whether it takes the other one before a later one."""
    calls = Release(has_numbers)
    hits = [*calls.send(100, 3, 0), *calls.take(110, 3), *calls.send(120, 9, 3), *calls.answer(130, 3)]
    hits += [*calls.take(140, 9), *calls.answer(150, 9), *calls.receive(160, 3)]
    hits += [*calls.send(165, 10, 9), *calls.answer(168, 10), *calls.receive(170, 9), *calls.receive(180, 10)]
    first, last = calls.call(50, 0, -1), calls.call(S, 11, 10)
    (stream,) = services(accumulate([*first, *hits, *last]))
    between = [(100, 160, 110, 130), (120, 170, 140, 150), (165, 180, NOT_SEEN_NS, 168)] if has_numbers else []
    assert rows(stream) == [(50, 110, 60, 90), *between, (S, S + 60, S + 10, S + 40)]
    assert stream.counts["unclear"] == (0 if has_numbers else 3)


def test_an_answer_out_of_order():
    """With numbers it is known whose it is; the server answers the later request first."""
    calls = Release(True)
    hits = [*calls.send(100, 1, 0), *calls.send(110, 2, 1), *calls.take(120, 1), *calls.take(130, 2)]
    hits += [*calls.answer(140, 2), *calls.receive(150, 2), *calls.answer(160, 1), *calls.receive(170, 1)]
    assert rows(*services(accumulate(hits))) == [(110, 150, 130, 140), (100, 170, 120, 160)]


def test_a_number_that_is_told_when_all_is_over():
    """Fast DDS tells it once the request is sent: the client's thread may lose its CPU before."""
    calls = Release(True)
    hits = [*calls.send(100, 7, 6, seen_after=500), *calls.call(100, 7, 6)[2:]]
    assert rows(*services(accumulate(hits))) == [(100, 160, 110, 140)]


def test_an_answer_from_another_thread():
    """Before Kilted it is not known when such a request was taken."""
    calls = Release(False)
    hits = [*calls.send(100, 1, 0), *calls.take(110, 1), *calls.answer(120, 1, tid=33), *calls.receive(130, 1)]
    (stream,) = services(accumulate(hits))
    assert rows(stream) == [(100, 130, NOT_SEEN_NS, 120)]
    assert stream.remarks == ("not known of 1 request when the server took it",)


def test_what_the_thread_has_taken_since_was_not_the_request():
    calls = Release(False)
    between = hit(115, "timer_call", pid=3, timer=1)
    hits = [*calls.send(100, 1, 0), *calls.take(110, 1), between, *calls.answer(120, 1), *calls.receive(130, 1)]
    assert rows(*services(accumulate(hits))) == [(100, 130, NOT_SEEN_NS, 120)]


@pytest.mark.parametrize("others", [0, 1])
def test_a_middleware_that_does_not_show_the_name_of_a_client(others):
    """An only client is the one that is meant; of two neither is."""
    calls = Release(False, has_gid=False)
    hits = [hit(105, "client_init", pid=2, endpoint=0xC1, service=NAME, node=0)] * others + calls.call(100, 1, 0)
    assert len(services(accumulate(hits))) == 1 - others


def test_a_server_that_is_not_observed():
    calls = Release(True)
    (stream,) = services(accumulate([*calls.send(100, 1, 0), *calls.receive(160, 1)]))
    assert dict(stream.identity) == {"service": NAME, "client": "/planner"}
    assert rows(stream) == [(100, 160, NOT_SEEN_NS, NOT_SEEN_NS)]


@both
def test_a_client_without_an_answer_is_overdue(has_numbers):
    """Each request of it, if it waited longer than ever before, and for three seconds."""
    calls = Release(has_numbers)
    hits = [*calls.call(100, 1, 0), *calls.send(S, 2, 1), *calls.send(2 * S, 3, 2), *calls.send(9 * S, 4, 3)]
    (stream,) = services(accumulate(hits, 10 * S))
    assert rows(stream) == [(100, 160, 110, 140)]
    assert (stream.open_ns, stream.more_open_ns, stream.counts["unanswered"]) == (9 * S, (8 * S,), 2)


def test_a_service_that_nobody_serves():
    (stream,) = services(accumulate(Release(True).send(S, 1, 0), 10 * S))
    assert stream.remarks == ("nobody answered: 1 request, the first for 9 s",) and stream.open_ns == 9 * S


@both
def test_what_was_sent_before_a_gap_is_not_joined_with_what_comes_after(has_numbers):
    calls = Release(has_numbers)
    hits = [
        *calls.send(100, 1, 0),
        *calls.take(110, 1),
        Gap(115, 120, "lost", GapCause.EVENTS_LOST),
        *calls.answer(130, 1),
        *calls.receive(140, 1),
    ]
    hits += calls.call(200, 2, 1)
    (stream,) = services(accumulate(hits, 10 * S))
    assert rows(stream) == [(200, 260, 210, 240)] and stream.open_ns == 0


def test_requests_that_nobody_answers_are_counted_beyond_those_that_are_kept():
    calls = Release(True)
    hits = [seen_hit for number in range(1, 1201) for seen_hit in calls.send(number * 100, number, number - 1)]
    (stream,) = services(accumulate(hits, 10 * S))
    assert stream.counts["lost"] + stream.counts["unanswered"] == 1200


def test_a_client_after_a_restart_goes_on():
    observed = FlowAccumulator(begin_ns=0)
    calls = Release(True)
    observed.observe([node(1, "planner"), node(3, "arm")])
    observed.feed(calls.call(100, 1, 0))
    observed.observe([node(3, "arm")])
    observed.feed([])
    again = Release(True, client=4, gid=9)
    observed.observe([node(4, "planner"), node(3, "arm")])
    observed.feed(again.call(1000, 1, 0))
    observed.finish()
    assert rows(*services(observed)) == [(100, 160, 110, 140), (1000, 1060, 1010, 1040)]


def test_the_services_and_topics_of_an_action_have_its_name():
    of_action = {"service": "/arm/grasp/_action/get_result", "client": "/planner", "server": "/arm"}
    assert STREAM.in_words(of_action)[0] == "service /arm/grasp (action, get_result) /planner -> /arm"
    of_action = {"topic": "/arm/grasp/_action/feedback", "publisher": "/arm", "subscriber": "/planner"}
    assert MESSAGES.in_words(of_action)[0] == "messages /arm/grasp (action, feedback) /arm -> /planner"
