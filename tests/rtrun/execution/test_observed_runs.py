"""What an attempt at a run that observes leaves of its streams."""

import json

import pytest
from made_flows import MS, S, node, publish
from written import write_record

from rtrun.cli import main
from rtrun.execution.stream_runs import StreamFacts, put_aside, write_streams
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.plan.observation import read_stream_deadline
from rtrun.results.record import read_record
from rtrun.targets.inspection.facts import TargetState


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


@pytest.mark.parametrize(("deadline", "misses"), [("50ms", 1), ("61s", 0)])
def test_a_publisher_that_hangs_for_good_misses_its_deadline(tmp_path, capsys, deadline, misses):
    """It sends for ten seconds, lives on, and is silent for fifty."""
    flows = FlowAccumulator(begin_ns=0)
    flows.observe([node(1, "talker")])
    flows.feed([publish(n * 10 * MS) for n in range(1, 1001)])
    flows.finish(60 * S)
    (tmp_path / "facts").mkdir()
    write_record(tmp_path / "facts", "observed_intervals", [], {}, subject="attached")
    times = {"start_time": "2026-11-21T10:00:00Z", "end_time": "2026-11-21T10:01:00Z"}
    deadlines = [read_stream_deadline(f"interval:/a={deadline}")]
    facts = StreamFacts(
        record=read_record(tmp_path / "facts"),
        state=TargetState(),
        deadlines=deadlines,
        programs=lambda *_: (),
        **times,
    )
    (tmp_path / "results").mkdir()
    written = write_streams(tmp_path / "results/001", facts, streams(flows), {})
    silent = "/a publisher /talker: no message in the last 50 s, though its program lives"
    assert (silent in written.left_out) is bool(misses)
    assert main(["gate", str(tmp_path / "results"), "--probability", "1e-3", "--json"]) == 1
    (case,) = json.loads(capsys.readouterr().out)["cases"]
    assert (case["n"], case["misses"]) == (999 + misses, misses)
