"""What an accumulator keeps over a whole observation is limited, whatever a target says."""

import pytest
from made_flows import gap, hit, node, program, publish, take

from rtrun.causes.ftrace import CALLBACK_CHARACTERS_MAX
from rtrun.flows import accumulator, matching, observation_state, topics
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.programs import NAME_CHARACTERS_MAX, label_of
from rtrun.probes import hits

LIMIT = 20
MORE = 10 * LIMIT
CALLS = [hit(n, "callback_begin", callback=n) for n in range(1, MORE)]
THREADS = [publish(n, tid=n) for n in range(1, MORE)]
NODES = [hit(n, "node_init", node=n, name=f"n{n}", namespace="/") for n in range(1, MORE)]
TIMERS = [hit(n, "timer_init", timer=n, period_ns=n) for n in range(1, MORE)]
TOPICS = [publish(n, f"/{n}", endpoint=n) for n in range(1, MORE)]
SUBSCRIPTIONS = [take(n, n, f"/{n}", endpoint=n) for n in range(1, MORE)]


@pytest.mark.parametrize("seen", [CALLS, THREADS, NODES, TIMERS, TOPICS, SUBSCRIPTIONS])
def test_things_that_live(monkeypatch, seen):
    monkeypatch.setattr(observation_state, "THINGS_MAX", LIMIT)
    observed = FlowAccumulator(begin_ns=0)
    observed.feed(seen)
    processes, threads = observed._programs.processes.values(), observed._programs.threads
    assert sum(process.things for process in processes) + len(threads) == LIMIT
    assert observed.state.left_out >= MORE - 1 - LIMIT


@pytest.mark.parametrize("seen", [TOPICS, SUBSCRIPTIONS])
def test_streams(monkeypatch, seen):
    monkeypatch.setattr(observation_state, "STREAMS_MAX", LIMIT)
    observed = FlowAccumulator(begin_ns=0)
    observed.feed(seen)
    assert len(observed.topics.ends) == LIMIT


def test_pids_of_names_of_programs_that_have_ended(monkeypatch):
    monkeypatch.setattr(observation_state, "LABELS_MAX", LIMIT)
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "a")])
    for pid in range(2, MORE):
        observed.observe([node(pid, "a" if pid % 2 else f"a{pid}")])
        observed.feed([publish(pid, pid=pid)])
    pids = observed.state.pids
    assert sum(map(len, pids.values())) == LIMIT and pids["/a"] >= {1, 3}


def test_names_of_programs():
    """Those of all programs that were there at any time are kept."""
    long = node(1, "y" * 60_000)
    assert label_of(long) == "/" + "y" * (NAME_CHARACTERS_MAX - 1)
    assert len(label_of(program(1, ("python3", "z" * 60_000)))) == NAME_CHARACTERS_MAX


def test_names_of_turns():
    turns = []
    observed = FlowAccumulator(begin_ns=0, on_turn=turns.append)
    observed.observe([node(1, "a")])
    observed.feed([hit(n, "callback_begin", callback=1, topic="/" + "y" * 60_000) for n in (1, 2)])
    assert [len(turn.name) for turn in turns] == [CALLBACK_CHARACTERS_MAX]


def test_messages_with_one_time_stamp():
    observed = FlowAccumulator(begin_ns=0)
    observed.feed([*(publish(n, stamp=5) for n in range(1, 1000)), hit(2000, "take", pid=2, topic="/a", source_ns=5)])
    (pair,) = observed.topics.pairs.values()
    assert len(pair.ambiguous) == matching._ALIKE_MAX == 64


def test_messages_that_wait(monkeypatch):
    monkeypatch.setattr(topics, "_OPEN_MAX", LIMIT)
    observed = FlowAccumulator(begin_ns=0)
    for n in range(1, MORE):
        observed.feed([publish(n)])
    assert sum(matching.open for matching in observed.topics._matchings()) <= LIMIT


def test_gaps_that_lie_close_together_are_joined(monkeypatch):
    for module in (hits, accumulator):
        monkeypatch.setattr(module, "GAPS_MAX", LIMIT)
    observed = FlowAccumulator(begin_ns=0)
    for n in range(1, MORE):
        observed.feed([gap(10 * n, 10 * n + 1 + n % 2)])
    assert LIMIT <= len(observed.gaps) <= 2 * LIMIT
    first, last = gap(10, 0), gap(0, 10 * (MORE - 1) + 2)
    assert (observed.gaps[0].from_ns, observed.gaps[-1].until_ns) == (first.from_ns, last.until_ns)
