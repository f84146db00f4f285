"""The trace for Perfetto, read with the classes that Perfetto publishes for its format."""

from collections import defaultdict

import pytest
from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent
from traced import OUTPUT, head, specimen, write_traced_run

from rtrun.causes.outliers import explain_run
from rtrun.cli import main
from rtrun.report.perfetto import perfetto
from rtrun.results.record import read_record


@pytest.fixture
def explained(tmp_path):
    again = specimen(1558).replace("at index 1558", "at index 1559", 1).splitlines(keepends=True)[0]
    folder = write_traced_run(
        tmp_path,
        {1558: specimen(1558), 1559: again + f"# in {OUTPUT}-trace-1558.txt\n", 1600: head(9, 1600, 1) + "# tracer\n"},
        [23166, 23175],
    )
    return list(explain_run(folder, read_record(folder)))


def slices(trace):
    """The slices of each track by its name, each as (begin, end, name); all are closed before the next begins."""
    names, tracks, opened = {}, defaultdict(list), {}
    for packet in trace.packet:
        if packet.HasField("track_descriptor"):
            names[packet.track_descriptor.uuid] = packet.track_descriptor.name
            continue
        event = packet.track_event
        if event.type == TrackEvent.TYPE_SLICE_BEGIN:
            assert event.track_uuid not in opened
            opened[event.track_uuid] = (packet.timestamp, event.name)
        else:
            assert event.type == TrackEvent.TYPE_SLICE_END
            begin_ns, name = opened.pop(event.track_uuid)
            assert begin_ns < packet.timestamp
            assert not tracks[names[event.track_uuid]] or tracks[names[event.track_uuid]][-1][1] <= begin_ns
            tracks[names[event.track_uuid]].append((begin_ns, packet.timestamp, name))
    assert not opened
    return tracks


def test_values_and_their_parts_and_what_each_cpu_did(explained):
    data = perfetto(explained)
    trace = Trace.FromString(data)
    assert trace.SerializeToString() == data, "a field is unknown or out of order"
    tracks = slices(trace)
    assert tracks["measured values"][-1] == (28840_758484122, 28840_760206000, "index 1558: 1.722 ms late")
    parts = tracks["what they waited for"]
    assert parts[0][2] == "thread of higher priority planted_hog"
    assert sum(end_ns - begin_ns for begin_ns, end_ns, _ in parts) == 1_721_878
    on_cpu = {name for _, _, name in tracks["CPU 1"]}
    assert {"planted_hog 23165", "interrupt local_timer", "cyclic_timer_te 23166"} <= on_cpu


def test_tracks_of_a_run_stand_together(explained):
    descriptors = [
        packet.track_descriptor
        for packet in Trace.FromString(perfetto(explained)).packet
        if packet.HasField("track_descriptor")
    ]
    run, *others = descriptors
    assert run.name == f"001-run {OUTPUT}"
    assert {other.parent_uuid for other in others} == {run.uuid}
    assert len({descriptor.uuid for descriptor in descriptors}) == len(descriptors)


def test_nothing_is_an_empty_trace():
    assert perfetto([]) == b""


def test_the_command_writes_the_file(tmp_path, capsys):
    folder = write_traced_run(tmp_path, {1558: specimen(1558)}, [23166, 23175])
    assert main(["why", str(folder), "--perfetto", str(tmp_path / "outliers.pftrace")]) == 0
    assert capsys.readouterr().out.endswith(f"written for ui.perfetto.dev: {tmp_path / 'outliers.pftrace'}\n")
    assert slices(Trace.FromString((tmp_path / "outliers.pftrace").read_bytes()))["measured values"]
    assert main(["why", str(folder), "--perfetto", str(tmp_path)]) == 2
