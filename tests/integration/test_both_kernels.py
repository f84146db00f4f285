"""Boards in QEMU that carry both kernels, restarted into each of them by the real runner: `make test-boards`."""

import json
from pathlib import Path

import pytest

import rtgen.cli
import rtrun.cli
from rtgen.board.machine import machines

# Cold boards, sysroots and suites take some minutes beside other work.
pytestmark = [pytest.mark.boards, pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(1800)]

TARGET = "{{schema: 1, name: board, kind: qemu, board: build/board/{machine}, suites: build/suites/{machine}}}"
CAMPAIGN = """
schema: 1
name: both
kernels: [standard, rt]
runs: [{suite: oneshot_timer_tests, repetitions: 50, policy: RR}]
"""


MACHINES = [name for name, each in machines().items() if each.standard_kernel is not None and each.qemu is not None]


@pytest.mark.parametrize("machine", MACHINES)
def test_runs_are_measured_on_their_kernels_and_compared(machine: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert rtgen.cli.main(["board", "build", "--machine", machine, "--kernel", "both"]) == 0
    assert rtgen.cli.main(["suites", "build", "--machine", machine]) == 0
    Path("target.yml").write_text(TARGET.format(machine=machine))
    Path("campaign.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "campaign.yml", "--target", "target.yml"]) == 0, capsys.readouterr()
    records = [json.loads(path.read_text()) for path in Path("results/both").glob("*/run.json")]
    in_order = sorted(records, key=lambda record: record["start_time"])
    # The board starts with rt: it was restarted into each.
    assert [record["kernel"] for record in in_order] == ["standard", "rt"]
    releases = json.loads(Path("build/board", machine, "board.json").read_text())["kernels"]
    for record in in_order:
        assert record["status"] == "ok"
        assert record["target"]["preempt_rt"] is (record["kernel"] == "rt")
        assert record["target"]["kernel_release"] == releases[record["kernel"]]["kernel_release"]
    capsys.readouterr()
    assert rtrun.cli.main(["compare", "results/both", "--by", "kernel"]) == 0
    output = capsys.readouterr().out
    assert "A: standard, B: rt" in output and "not a real-time statement" in output.splitlines()[1]
    assert "not compared" not in output and "only in" not in output
