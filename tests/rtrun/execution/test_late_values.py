"""What is kept to explain late values is limited, whatever a target says, and so are their traces."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_flows import MS, S, gap, hit

from rtrun.execution import late_values
from rtrun.execution.late_values import LateValueRecord
from rtrun.flows.live import BinnedValues, NewValues
from rtrun.flows.turns import Turn
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.probes.formats import EventFormat
from rtrun.probes.kernel_events import WaitingEvents
from rtrun.results import texts
from rtrun.results.texts import TextStore
from watched import SWITCH, switch

KINDS = [("sched/sched_switch", EventFormat(SWITCH))]
LIMIT = 50


def events(times_ns):
    waiting = WaitingEvents(KINDS)
    for at_ns in times_ns:
        waiting.add(at_ns, 0, 70, 7, 0, switch())
    return waiting.cut(1 << 62, [])


def batch(times_ns=(), hits=(), gaps=()):
    return SimpleNamespace(kernel=events(times_ns), hits=hits, gaps=gaps)


def values(source, times_ns):
    times_ns = np.array(times_ns)
    return NewValues(source, MESSAGES, np.full(times_ns.size, MS), times_ns, BinnedValues())


def test_hits_while_the_clock_of_the_target_stands_still(monkeypatch):
    monkeypatch.setattr(late_values, "HITS_MAX", LIMIT)
    late = LateValueRecord("1us", {})
    for _ in range(100):
        late.record(batch(hits=[hit(5, "take", tid=7)] * 9))
        late.cut(5)
    assert sum(times.size for times, _ in late._hits) == late._hit_count == 45


def test_events_of_the_kernel(monkeypatch):
    size = events(range(9)).size_bytes
    monkeypatch.setattr(late_values, "EVENTS_BYTES_MAX", 5 * size)
    late = LateValueRecord("1us", {})
    for number in range(20):
        late.record(batch([number] * 9))
        late.cut(5)
    assert [kept.at_ns[0] for kept in late._events] == [15, 16, 17, 18, 19]
    late.cut(late_values.KEPT_NS + 17)
    assert late._events_bytes == 3 * size


def test_gaps_that_end_far_in_the_future(monkeypatch):
    monkeypatch.setattr(late_values, "GAPS_MAX", LIMIT)
    monkeypatch.setattr("rtrun.probes.hits.GAPS_MAX", LIMIT)
    late = LateValueRecord("1us", {})
    for number in range(20):
        late.record(batch(gaps=[gap(10 * (9 * number + n), 10 * (9 * number + n) + 1) for n in range(9)]))
        late.cut(5)
    assert len(late._gaps) <= LIMIT


@pytest.mark.parametrize(("limit", "count"), [("TURNS_MAX", LIMIT), ("TURN_CHARACTERS_MAX", 12)])
def test_turns(monkeypatch, limit, count):
    monkeypatch.setattr(late_values, limit, LIMIT)
    late = LateValueRecord("1us", {})
    for number in range(200):
        late.turn(Turn(number, number + 1, 0, 70, 7, f"{number:4}"))
    assert len(late._turns) == count and late._turn_characters == 4 * count
    late.cut(late_values.KEPT_NS + 198)
    assert [turn.begin_ns for turn in late._turns] == [198, 199] and late._turn_characters == 8


def test_traces_of_late_values_are_stored(tmp_path):
    late = LateValueRecord("1us", {}, tmp_path)
    late.turn(Turn(S - MS, S - 5, 0, 70, 7, "timer 1 ms of /a"))
    late.record(batch([S - 2 * MS, S - 10, S + 10], hits=[hit(S, "take", tid=7)]))
    late.look(values("stream", [S]))
    late.cut(2 * S)
    (value,) = late.streams["stream"].kept
    lines = b"".join(value.text.pieces()).decode().splitlines()
    assert ["callback_end" in line for line in lines] == [False, False, True, False]
    assert value.tid == 7 and not list(tmp_path.iterdir()), "the file has a name"


@pytest.mark.parametrize(
    ("limit", "expected"),
    [("TEXT_BYTES_MAX", [True, True, False]), ("ONE_TEXT_BYTES_MAX", [True, False, True])],
)
def test_texts_beyond_their_limit(monkeypatch, tmp_path, limit, expected):
    monkeypatch.setattr(texts, limit, LIMIT)
    store = TextStore(tmp_path)
    stored = [store.add(["x" * 19, "\n"] * lines) for lines in ((1, 1, 1) if "ONE" not in limit else (1, 9, 1))]
    assert [bool(text) for text in stored] == expected
    assert all(b"".join(text.pieces()) == b"x" * 19 + b"\n" for text in stored if text)


def test_texts_of_a_disk_that_is_full(monkeypatch):
    def refuse(**_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(texts.tempfile, "TemporaryFile", refuse)
    store = TextStore(None)
    assert not store.add(["x"]) and store.is_full


def test_text_that_is_made_at_one_time(monkeypatch):
    """The others are made the next time."""
    monkeypatch.setattr(late_values, "TEXT_BYTES_AT_ONCE_MAX", 100)
    late = LateValueRecord("1us", {})
    late.record(batch(range(S - MS, S, MS // 10)))
    for source in range(3):
        late.look(values(source, [S]))
    counts = []
    for _ in range(4):
        late.cut(2 * S)
        counts.append(sum(bool(stream.kept[0].text) for stream in late.streams.values()))
    assert counts == [1, 2, 3, 3]
