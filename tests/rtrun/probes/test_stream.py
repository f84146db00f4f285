"""The output of watch_probes.sh: pages of the ring buffer as the kernel makes them, and anything else."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrun.probes import stream
from rtrun.probes.formats import EventFormat
from rtrun.probes.libraries.description import libraries
from rtrun.probes.ring_buffer import PageLayout, read_events, read_head
from rtrun.probes.stream import Batch, Ready, WatchReader
from rtrun.probes.timers import TimerChecks
from rtrun.probes.values import converter
from rtrun.targets.errors import TargetError
from watched import BEGUN, FIELD, HEADERS, PROBE, ROUNDS, SWITCH, TAKE, a_round, event, mark, output, page, switch, take


def extend(ns):
    return struct.pack("<II", (ns & (1 << 27) - 1) << 5 | 30, ns >> 27)


def stamp(ns):
    return struct.pack("<II", (ns & (1 << 27) - 1) << 5 | 31, (ns & (1 << 59) - 1) >> 27)


@pytest.mark.parametrize("bits", [64, 32])
def test_events_of_a_page(bits):
    layout = PageLayout.read(HEADERS[bits])
    begin_ns = (1 << 59) + 1000
    data = b"".join([
        event(0, take(1)), event(5, take(2, topic=b"/" + b"t" * 200 + b"\0")),
        struct.pack("<II", 1 << 5 | 29, 8) + bytes(4),  # discarded
        extend(10**12), event(3, take(3)), stamp(begin_ns + 3 * 10**12), event(0, take(4)),
        struct.pack("<I", 29),  # the rest is empty
    ])  # fmt: skip
    content = page(begin_ns, data, bits=bits)
    reader = EventFormat(TAKE)
    seen = [
        (at_ns, reader.values(content, start, size))
        for at_ns, start, size in read_events(content, layout, read_head(content, layout))
    ]
    assert [(at_ns - begin_ns, values["source_ns"]) for at_ns, values in seen] == [
        (0, 1), (5, 2), (10**12 + 8, 3), (3 * 10**12, 4)
    ]  # fmt: skip
    assert [len(values["topic"]) for _, values in seen] == [2, 201, 2, 2]
    assert seen[0][1] == {"source_ns": 1, "taken": 1, "topic": "/a"}


@pytest.mark.parametrize(
    ("flags", "lost", "count"), [(0, b"", None), (1 << 31, b"", None), (3 << 30, struct.pack("<Q", 42), 42)]
)
def test_lost_events(flags, lost, count):
    layout = PageLayout.read(HEADERS[64])
    head = read_head(page(5, event(0, take(1)), flags=flags, lost=lost), layout)
    assert (head.has_lost, head.lost, head.length) == (bool(flags), count, 4 + len(take(1)))


@pytest.mark.parametrize("piece", [1, 7, 4096, 10**6])
def test_batches_of_pieces_of_any_size(piece):
    reader = WatchReader({"take_0_1": PROBE}, "board", {7: 70})
    text = output(*ROUNDS)
    results = [result for start in range(0, len(text), piece) for result in reader.feed(text[start : start + piece])]
    ready, *batches = [*results, reader.rest()]
    assert ready == Ready(placed=("take_0_1",), refused={})
    # Before the beginning (0), and while the probes rested (4), there is nothing; in the order of time of both CPUs.
    assert [[hit.values["source_ns"] for hit in batch.hits] for batch in batches] == [[], [1, 2, 3], [5]]
    assert {(hit.pid, hit.tid, hit.event) for batch in batches for hit in batch.hits} == {(70, 7, "take")}
    assert [gap.reason.partition(":")[0] for batch in batches for gap in batch.gaps] == [
        "the kernel lost events of CPU 1", "the probes rested"
    ]  # fmt: skip
    assert (
        reader.is_done
        and reader.lost == 9
        and [(reading.clock, reading.offset_ns) for reading in batches[-1].clocks] == [("system", 100)]
    )


def batches_of(text):
    reader = WatchReader({"take_0_1": PROBE}, "board", {7: 70})
    return [*(result for result in reader.feed(text) if isinstance(result, Batch)), reader.rest()]


def test_a_gap_that_lasts_longer_than_its_round_comes_with_the_hits_within_it():
    """The buffer of CPU 1 was overwritten while CPU 0 was printed: its page begins after the mark of the round."""
    late = page(2500, event(0, take(6)), flags=3 << 30, lost=struct.pack("<Q", 9))
    first = a_round(1, cpu0=page(1000, BEGUN), cpu1=page(1200, event(0, take(4))))
    second = a_round(2, cpu0=page(1900, event(0, take(5)) + event(100, mark("round 2"))), cpu1=late)
    batches = batches_of(output(first, second, a_round(3, cpu0=page(3000, event(0, mark("round 3"))))))
    (batch,) = [batch for batch in batches if batch.gaps]
    assert [hit.values["source_ns"] for hit in batch.hits] == [3, 4, 5]
    assert [(gap.from_ns, gap.until_ns) for gap in batch.gaps] == [(1200, 2500)]


def test_gaps_of_a_round_are_joined_beyond_their_limit():
    lost = b"".join(page(1100 + number, b"", flags=1 << 31) for number in range(3000))
    first = a_round(1, cpu0=page(1000, BEGUN), cpu1=lost)
    second = a_round(2, cpu0=page(5000, event(0, mark("round 2"))))
    gaps = [gap for batch in batches_of(output(first, second)) for gap in batch.gaps]
    assert len(gaps) == stream._GAPS_MAX and max(gap.until_ns for gap in gaps) == 1100 + 2999


def test_ended_programs_of_a_round_are_limited():
    *_, last = batches_of(output(a_round(1, cpu0=page(1000, BEGUN)), b"ended 5\n" * (stream._ENDED_MAX + 9)))
    assert len(last.ended) == stream._ENDED_MAX


@pytest.mark.parametrize("limit", ["_HITS_MAX", "_HITS_BYTES_MAX", "_KERNEL_EVENTS_MAX", "_KERNEL_BYTES_MAX"])
def test_events_beyond_their_limit_are_left_out_and_are_a_gap(monkeypatch, limit):
    is_kernel = limit.startswith("_KERNEL")
    body = switch() if is_kernel else take(1)
    monkeypatch.setattr(stream, limit, 50 * len(body) if "BYTES" in limit else 50)
    described = f"format /events/sched/sched_switch/format\n{SWITCH}rtrun end format\n".encode()
    pages = b"".join(page(2000 * number, event(1, body) * 20) for number in range(1, 9))
    text = output(a_round(1, cpu0=page(1000, BEGUN), cpu1=pages))
    *_, last = batches_of(text.replace(b"ready\n", described + b"ready\n", 1))
    kept = last.kernel if is_kernel else last.hits
    assert 0 < len(kept) <= 50 and [gap.reason for gap in last.gaps] == [stream.TOO_MANY]


def test_rounds_that_come_faster_than_time_goes_by():
    with pytest.raises(TargetError, match="rounds that follow one another faster than once in a second"):
        batches_of(output(*(f"round {number}\n".encode() for number in range(1, 200))))


TAKEN_OFF, LEFT = b"rtrun end done\n", b"rtrun end left 1_2_3\n"


@pytest.mark.parametrize(
    "end", [b"", b"pages 1\n", TAKEN_OFF, LEFT, b"rounds end\n" + TAKEN_OFF, b"rounds end\n" + LEFT]
)
def test_a_round_that_was_cut_off_is_no_whole_one(end):
    """The pages of another CPU, of before these, did not come. That the probes were taken off tells nothing of that."""
    first, second = a_round(1, cpu0=page(1000, BEGUN)), a_round(2, cpu0=page(2000, event(0, take(5))))
    *_, last = batches_of(output(first, second, end=end))
    is_whole = end.startswith(b"rounds end")
    assert [hit.values["source_ns"] for hit in last.hits] == [3, 5] * is_whole
    assert last.until_ns == (2001 if is_whole else 1010)


@pytest.mark.parametrize("piece", [1, 10**6])
@pytest.mark.parametrize("end", [TAKEN_OFF, LEFT])
@pytest.mark.parametrize("within", [b"", b"pages 1\n", b"programs\n", b"programs\nprogram 7\n", b"format x\nname: x\n"])
def test_what_was_taken_off_is_told_wherever_the_printer_was_killed(within, end, piece):
    reader = WatchReader({"take_0_1": PROBE}, "board", {7: 70})
    text = output(a_round(1, cpu0=page(1000, BEGUN)), end=within + end)
    for start in range(0, len(text), piece):
        list(reader.feed(text[start : start + piece]))
    assert (reader.is_done, reader.is_read_to_end) == (end == TAKEN_OFF, False)


@settings(max_examples=300)
@given(st.data())
def test_no_exception_of_another_kind(data):
    text = bytearray(output(*ROUNDS))
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(text) - 1))
        size = data.draw(st.integers(0, 8))
        text[place : place + size] = data.draw(st.binary(max_size=8))
    reader = WatchReader({"take_0_1": PROBE}, "board", {})
    try:
        results = list(reader.feed(bytes(text)))
        reader.rest()
    except TargetError as error:
        assert str(error).startswith("board: what watch_probes.sh printed cannot be read: ")
    else:
        assert all(isinstance(result, Batch | Ready) for result in results)


@pytest.mark.parametrize(
    "text",
    [
        "name: x\n", "ID: 5\n", TAKE.replace("offset:24", "offset:23"), TAKE.replace("offset:4;", "offset:6;"),
        TAKE.replace("size:4;\tsigned:1;\n\nprint", "size:8;\tsigned:1;\n\nprint"),
        TAKE.replace("offset:16", "offset:99999"),
    ],
)  # fmt: skip
def test_formats_that_are_refused(text):
    with pytest.raises(ValueError, match=r"^(no |in |the )"):
        EventFormat(text)


def test_fields_that_all_name_one_text():
    """Of a probe only its own values are read; of any event its texts take no more than it has."""
    more = "".join(FIELD.format("__data_loc char[]", f"x{n}", 29 + 4 * n, 4, 1) for n in range(100))
    text = TAKE.replace("\nprint fmt", f"{more}\nprint fmt")
    content = struct.pack("<HBBiQqB101I", 1500, 0, 0, 7, 0, 1, 1, *[1000 << 16 | 429] * 101) + b"y" * 1000
    types = {"source_ns": "s64", "taken": "u8", "topic": "string"}
    assert EventFormat(text, types).values(content, 0, len(content)).keys() == types.keys()
    with pytest.raises(ValueError, match="whose texts together are longer than its"):
        EventFormat(text).values(content, 0, len(content))


@pytest.mark.parametrize(
    ("name", "kind"), [("source_ns", "u64"), ("source_ns", "string"), ("topic", "u32"), ("taken", "u16"), ("x", "u8")]
)
def test_a_value_of_a_probe_that_is_not_of_its_type(name, kind):
    with pytest.raises(ValueError, match=f"the format of take_0_1 has no field {name} that is a {kind}"):
        EventFormat(TAKE, {name: kind})


def test_values_are_made_canonical():
    probes = {probe.event: probe for probe in libraries()["libroscpp"].probes}
    published = probes["publish"].arguments["x86_64"]
    values = {"endpoint": 1, "topic": "/a", "size": 9, "key0": 2**64 - 1, "key1": 7}
    converter(published, {})(values)
    # Five bytes, and nothing of what is in memory behind them.
    assert values == {"endpoint": 1, "topic": "/a", "size": 5, "key0": 2**40 - 1, "key1": 0}
    values |= {"size": 0}
    converter(published, {})(values)
    # No bytes at all: what is read in their place counts for nothing, and it is no message of 0 bytes.
    assert values == {"endpoint": 1, "topic": "/a", "key0": 0, "key1": 0}
    halves = libraries()["libtracetools"].probes[0].arguments["armv7"]
    values = {"endpoint": 1, "topic": "/a", "source_ns_low": 0xFFFFFFFE, "source_ns_high": 0xFFFFFFFF}
    converter(halves, {})(values)
    assert values["source_ns"] == -2
    timer = libraries()["librcl"].probes[0].arguments["x86_64"]
    values = {"timer": 1, "period_ns": 5, "expected_ns": 6, "clock": 77}
    converter(timer, {})(values)
    assert values == {"timer": 1, "period_ns": 5, "expected_ns": 6}


def test_timers_are_believed_on_their_grid_alone():
    checks = TimerChecks()

    def checked(period_ns, expected_ns, timer=1):
        values = {"timer": timer, "period_ns": period_ns, "expected_ns": expected_ns, "clock": "steady"}
        checks.check(timer, values)
        return values.get("period_ns"), values.get("expected_ns")

    calls = [(10, 100), (10, 110), (10, 140), (10, 145), (10, 155), (10, 155), (20, 175), (0, 5), (-5, 0), (10**17, 3)]
    assert [checked(*call) for call in calls] == [
        (None, None), (10, 110), (10, 140), (10, None), (10, 155), (10, None), *[(None, None)] * 4
    ]  # fmt: skip
    assert checked(10, 165, timer=2) == (None, None)
    # A release whose timers have another pointer there: it is no period of a day.
    heap = 0x55D0_1234_5678
    assert [checked(heap, 10**12 + 10**7 * call, timer=3) for call in range(9)] == [(None, None)] * 9


def test_how_far_the_raw_clock_is_ahead():
    """What writes the marks was kept from its CPU in round 2; round 3 has more lines than marks."""
    begun = BEGUN + b"".join(event(after, mark("raw 1")) for after in (0, 12_000, 5_000, 10_000))
    second = event(0, mark("round 2")) + event(0, mark("raw 2")) + event(900_000, mark("raw 2"))
    third = event(0, mark("round 3")) + event(0, mark("raw 3")) + event(9_000, mark("raw 3"))
    batches = batches_of(
        output(
            a_round(1, cpu0=page(1000, begun)) + b"raw 1 700\nraw 1 720\n",
            a_round(2, cpu0=page(2 * 10**6, second)) + b"raw 2 9999\n",
            a_round(3, cpu0=page(4 * 10**6, third)) + b"raw 3 9999\nraw 3 9999\n",
        )
    )
    # The begin of the page, what comes before the marks, those before the nearest two, and the middle of these.
    at_ns = 1000 + 110 + 12_000 + 5_000 + 5_000
    raw = [reading for batch in batches for reading in batch.clocks if reading.clock == "raw"]
    assert raw == [("raw", at_ns, 720_000 - at_ns)]
