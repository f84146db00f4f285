"""What is measured for hours is on the disk: the same comes of it, and it stays within its limits."""

import random

import numpy as np
import pytest
from made_flows import BEGIN_NS, MS, S, System, gap, hit, listener, node, publish, take, talker

from rtrun.flows import decided, messages, rows, timers, topics, values
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures
from rtrun.flows.observed import source
from rtrun.flows.rows import RowStore
from rtrun.flows.streams import streams
from rtrun.results import columns
from rtrun.results.columns import NoRoom

OVER_GAP = System([talker(), talker("/other", 3, period_ns=7 * MS), listener()], loss=0.1, doubled=0.1, slow=0.05)
OF_BYTES = System([talker(payloads=40), listener()], loss=0.02, is_ordered=True)


@pytest.fixture
def all_on_disk(monkeypatch, tmp_path):
    for module in (rows, timers, source, values, decided, columns):
        monkeypatch.setattr(module, "PIECE_ROWS", 7)
    monkeypatch.setattr(rows, "IN_MEMORY_BYTES_MAX", 0)
    monkeypatch.setattr(rows, "_EXTENT_BYTES_LEAST", 1)


def test_rows_are_read_as_they_were_added(monkeypatch, tmp_path, all_on_disk):
    chance = random.Random(1)
    store = RowStore(tmp_path)
    tables = [(store.rows(width), []) for width in (1, 3)]
    for number in range(400):
        table, expected = chance.choice(tables)
        row = [number, *(chance.randrange(-(2**63), 2**63) for _ in range(table.width - 1))]
        table.add(row)
        expected.append(row)
        if chance.random() < 0.2:
            store.ease()
        if table.width > 1 and chance.random() < 0.3:
            changed = chance.randrange(len(expected))
            expected[changed][1] = number
            table.put(changed, 1, number)
        begin, end = sorted(chance.randrange(len(expected) + 1) for _ in range(2))
        assert len(table) == len(expected) and table.read(begin, end).tolist() == expected[begin:end]
        assert table[-1] == number == table[len(expected) - 1]
    for table, expected in tables:
        assert np.concatenate([*table.pieces()]).tolist() == expected
        assert [column.tolist() for column in table.columns()] == np.array(expected).T.tolist()
        within = [row[0] for row in expected if 50 <= row[0] < 90]
        assert table.between(50, 90).tolist() == within
    assert not list(tmp_path.iterdir()), "the file has a name"


def test_rows_in_order(all_on_disk):
    chance = random.Random(2)
    store = RowStore()
    table = store.rows(2)
    numbers = [[chance.randrange(number // 2, number + 20), number] for number in range(300)]
    for row in numbers:
        table.add(row)
    pieces = [*table.in_order(0)]
    assert np.concatenate(pieces).tolist() == sorted(numbers, key=lambda row: row[0])
    assert max(map(len, pieces)) < 300


@pytest.mark.parametrize("system", [OVER_GAP, OF_BYTES])
def test_streams_are_the_same_from_the_disk(request, system):
    def read():
        observed, _ = system.observe(gaps=[gap(6, 7)])
        figures = LiveFigures(observed).snapshot(BEGIN_NS + 30 * S)
        return [*streams(observed)], figures

    in_memory, before = read()
    request.getfixturevalue("all_on_disk")
    from_disk, after = read()
    assert before == after and len(in_memory) == len(from_disk) > 2
    assert any(isinstance(column, np.memmap) for stream in from_disk for column in stream.columns.values())
    for stream, other in zip(in_memory, from_disk, strict=True):
        for name in ("kind", "identity", "counts", "remarks", "open_ns", "period_ns"):
            assert getattr(stream, name) == getattr(other, name), name
        assert stream.columns.keys() == other.columns.keys() and np.array_equal(stream.cuts, other.cuts)
        assert all(np.array_equal(column, other.columns[key]) for key, column in stream.columns.items())


def test_timers_are_the_same_from_the_disk(request):
    """One that skips a period now and then, and a gap."""

    def read():
        observed = FlowAccumulator(begin_ns=0)
        timer_values = {"timer": 5, "period_ns": 10 * MS, "clock": "steady"}
        numbers = [n for n in range(1, 300) if n % 14]
        calls = [hit(n * 10 * MS + n, "timer_call", expected_ns=n * 10 * MS, **timer_values) for n in numbers]
        observed.feed([*calls, gap(1.2, 1.3)._replace(from_ns=1200 * MS, until_ns=1300 * MS)])
        (stream,) = streams(observed)
        return stream

    in_memory = read()
    request.getfixturevalue("all_on_disk")
    from_disk = read()
    assert in_memory.counts == from_disk.counts and in_memory.counts["skipped"] == 20
    assert in_memory.cuts.tolist() == from_disk.cuts.tolist() and in_memory.cuts.size == 1
    assert all(np.array_equal(column, from_disk.columns[key]) for key, column in in_memory.columns.items())


def fed(count):
    observed = FlowAccumulator(begin_ns=0)
    observed.observe([node(1, "talker"), node(2, "listener")])
    for n in range(1, count):
        observed.feed([publish(n * MS), take(n * MS + 5, n * MS)])
    return observed


@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        ("BYTES_MAX", "more values than are kept of one observation"),
        ("_EXTENTS_MAX", "more values than are kept of one observation"),
        ("ROWS_MAX", "more than 50 values of one stream"),
    ],
)
def test_more_than_is_kept(monkeypatch, all_on_disk, limit, reason):
    monkeypatch.setattr(rows, limit, 50)
    with pytest.raises(NoRoom, match=reason):
        fed(100)


def test_a_disk_that_is_full(monkeypatch, all_on_disk):
    """What was there before is kept, and the reason says what the system says."""
    observed = fed(30)

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rows.os, "pwrite", refuse)
    with pytest.raises(NoRoom, match="cannot keep what is observed: No space left on device"):
        observed.feed([publish(99 * MS), take(100 * MS, 99 * MS)])
    observed.finish()
    (pair,) = observed.topics.pairs.values()
    assert len(pair.rows) == 30 and pair.rows.read()[-1].tolist()[:2] == [99 * MS, 100 * MS]
    monkeypatch.setattr(columns.tempfile, "TemporaryFile", refuse)
    found = [*streams(observed)]
    assert [stream.identity for stream in found if stream.trouble] == [stream.identity for stream in found]
    assert not any(stream.columns for stream in found)


def test_time_without_a_link_is_not_kept_as_objects():
    """A publisher that is made anew before each message begins a new count each time."""
    observed = FlowAccumulator(begin_ns=0)
    for n in range(1, 500):
        init = hit(2 * n * MS - 1, "publisher_init", endpoint=0xA0, topic="/a")
        observed.feed([init, publish(2 * n * MS), take(2 * n * MS + 5, 2 * n * MS)])
    (pair,) = observed.topics.pairs.values()
    assert len(pair.links) == 498 and pair.lost_so_far == 0
    assert decided.DecidedMessages(pair).counts().received == 499


def test_receptions_that_may_be_any_of_many_messages(monkeypatch):
    """Each subscriber that takes a stamp of 64 messages is noted at each of these."""
    for module in (messages, topics):
        monkeypatch.setattr(module, "TAKERS_MAX", 1000)
    observed = FlowAccumulator(begin_ns=0)
    most = 0
    for n in range(1, 200):
        many = [publish(n * MS + m, stamp=5) for m in range(50)]
        observed.feed([*many, hit(n * MS + 500, "take", pid=1000 + n, topic="/a", source_ns=5)])
        remembered = {
            id(publication): publication
            for matching in observed.topics._matchings()
            for some in matching._open.values()
            for publication in some
        }
        taken = sum(len(publication.takers) for publication in remembered.values())
        assert observed.topics.takers == taken
        most = max(most, taken)
    assert 400 < most <= 500


def test_receptions_of_one_round_that_may_be_any_of_many_messages(monkeypatch):
    """It is not waited for the end of the round."""
    for module in (messages, topics):
        monkeypatch.setattr(module, "TAKERS_MAX", 1000)
    observed = FlowAccumulator(begin_ns=0)
    seen = []
    ambiguous = observed.topics.ambiguous
    monkeypatch.setattr(
        observed.topics, "ambiguous", lambda *outcome: (ambiguous(*outcome), seen.append(observed.topics.takers))
    )
    hits = []
    for n in range(1, 200):
        hits += [publish(n * MS + m, stamp=5) for m in range(50)]
        hits.append(hit(n * MS + 500, "take", pid=n, topic="/a", source_ns=5))
    observed.feed(hits)
    assert 900 < max(seen) <= 1000 + 64
