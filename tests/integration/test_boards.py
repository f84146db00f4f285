"""Every machine in QEMU, measured on by the real runner with the suites that were built for it: `make test-boards`."""

import json
import platform
from pathlib import Path

import pytest

import rtgen.cli
import rtrun.cli
from rtgen.board.machine import machines
from rtrun.report.terminal import BANNERS
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.qemu import emulator as qemu

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
kernels: [{kernels}]
common: {{repetitions: 50, policy: RR}}
runs:
  - {{suite: oneshot_timer_tests}}
  - {{suite: communication_tests, frequency_hz: 50}}
"""


def measure(machine: str, folder: Path, *suite: str, kernel: str = "debian") -> list[Path]:
    """Build board and suites, the board with this kernel, run the campaign in the current folder; the runs in order."""
    assert rtgen.cli.main(["board", "build", "--machine", machine, "--kernel", kernel, *suite]) == 0
    assert rtgen.cli.main(["suites", "build", "--machine", machine, *suite]) == 0
    target = folder / "target.yml"
    target.write_text(TARGET.format(machine=machine))
    (folder / "campaign.yml").write_text(CAMPAIGN.format(kernels="standard, rt" if kernel == "both" else "rt"))
    assert rtrun.cli.main(["run", "campaign.yml", "--target", str(target)]) == 0
    runs = [path.parent for path in (folder / "results/boards").glob("*/run.json")]
    assert len(runs) == (4 if kernel == "both" else 2)
    return sorted(runs, key=lambda run: json.loads((run / "run.json").read_text())["start_time"])


@pytest.mark.parametrize("machine", ["qemu-armv7", "qemu-x86_64"])
def test_suites_measure_on_debian_13(machine: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for run in measure(machine, tmp_path, "--suite", "trixie"):
        record = json.loads((run / "run.json").read_text())
        assert (record["status"], record["target"]["preempt_rt"]) == ("ok", True)
        assert record["target"]["kernel_release"].startswith("6.12.")
        state = json.loads((run / "target.json").read_text())["before"]
        assert "VERSION_CODENAME=trixie" in state["os_release"].splitlines()
        # The last of ROS 1.
        assert record["target"]["middleware_version"].startswith("1.17.")


@pytest.mark.kernel
@pytest.mark.timeout(3 * 3600)  # the kernel is built, five minutes on two idle cores
def test_suites_measure_on_a_kernel_whose_mainline_has_preempt_rt(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for run in measure("qemu-armv7", tmp_path, kernel="7.2"):
        record = json.loads((run / "run.json").read_text())
        assert (record["status"], record["target"]["preempt_rt"]) == ("ok", True)
        assert record["target"]["kernel_release"].startswith("7.2.")
        configuration = str(run / "kernel.config.gz")
        assert rtgen.cli.main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", configuration]) == 0


@pytest.mark.parametrize("machine", [name for name, machine in machines().items() if machine.qemu is not None])
def test_suites_measure_on_both_kernels_of_the_machine(machine: str, tmp_path: Path, monkeypatch, capsys) -> None:
    """The board starts with PREEMPT_RT: it is restarted into each kernel."""
    monkeypatch.chdir(tmp_path)
    runs = measure(machine, tmp_path, kernel="both")
    output, errors = capsys.readouterr()
    # The real /dev/kvm of this machine, if there is one: used, or not used and said so.
    folder = tmp_path / "build/board" / machine
    board = qemu.read_board(folder)
    tried = board.qemu.kvm is not None and board.qemu.kvm.processor == platform.machine()
    platform_here = qemu.platform_of(board, folder).platform
    emulated = platform_here is Platform.EMULATED
    assert BANNERS[platform_here] in output
    assert errors.count("rtrun: KVM does not work here, ") == (1 if tried and emulated else 0), errors
    for run, kernel in zip(runs, ("standard", "standard", "rt", "rt"), strict=True):
        record = json.loads((run / "run.json").read_text())
        assert (record["status"], record["platform"], record["kernel"]) == ("ok", platform_here, kernel)
        assert record["target"]["preempt_rt"] is (kernel == "rt")
        assert record["target"]["kernel_release"] == board.kernels[kernel].kernel_release
    assert rtrun.cli.main(["compare", "results/boards", "--by", "kernel"]) == 0
    output = capsys.readouterr().out
    assert "A: standard, B: rt" in output
    assert "not compared" not in output and "only in" not in output
