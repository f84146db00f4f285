"""Every machine in QEMU, measured on by the real runner with the suites that were built for it: `make test-boards`."""

import json
import platform
from pathlib import Path

import pytest

import rtgen.cli
import rtrun.cli
from rtgen.board.machine import machines
from rtrun.report.terminal import BANNERS
from rtrun.target import qemu
from rtrun.target.platform import Platform

# A cold board, its sysroot and its suites take some minutes beside other work.
pytestmark = [pytest.mark.boards, pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(1800)]

TARGET = """
schema: 1
name: {machine}
kind: qemu
board: build/board/{machine}
suites: build/suites/{machine}
"""
CAMPAIGN = """
schema: 1
name: boards
common: {repetitions: 50, policy: RR}
runs:
  - {suite: oneshot_timer_tests}
  - {suite: communication_tests, frequency_hz: 50}
"""


@pytest.mark.parametrize("machine", [name for name, each in machines().items() if each.qemu is not None])
def test_suites_measure_on_the_machine(machine: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert rtgen.cli.main(["board", "build", "--machine", machine]) == 0
    assert rtgen.cli.main(["suites", "build", "--machine", machine]) == 0
    target = tmp_path / "target.yml"
    target.write_text(TARGET.format(machine=machine))
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "campaign.yml", "--target", str(target)]) == 0, capsys.readouterr()
    output, errors = capsys.readouterr()
    # The real /dev/kvm of this machine, if there is one: used, or not used and said so.
    folder = tmp_path / "build/board" / machine
    board = qemu.read_board(folder)
    tried = board.qemu.kvm is not None and board.qemu.kvm.processor == platform.machine()
    platform_here = qemu.platform_of(board, folder).platform
    emulated = platform_here is Platform.EMULATED
    assert BANNERS[platform_here] in output
    assert errors.count("rtrun: KVM does not work here, ") == (1 if tried and emulated else 0), errors
    records = [json.loads(path.read_text()) for path in (tmp_path / "results/boards").glob("*/run.json")]
    assert len(records) == 2
    for record in records:
        assert (record["status"], record["platform"]) == ("ok", platform_here)
        assert record["target"]["preempt_rt"] is True
