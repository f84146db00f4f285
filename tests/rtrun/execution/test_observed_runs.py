"""What an attempt at a run that observes leaves of its streams."""

from written import write_record

from rtrun.execution.stream_runs import put_aside


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
