"""KVM is used where a guest ends, and nowhere else; a QEMU that stands in for one where KVM does this or that."""

import os
import platform
from pathlib import Path

import pytest

from rtrun.targets.inspection.platform import Platform
from rtrun.targets.qemu import emulator as qemu
from rtrun.targets.qemu import kvm


def stand_in(tmp_path: Path, script: str) -> str:
    """A program instead of QEMU, which writes down that it was called."""
    program = tmp_path / "qemu"
    program.write_text(f'#!/bin/sh\necho "$*" >> {tmp_path}/calls\n{script}\n')
    program.chmod(0o755)
    return str(program)


def calls(tmp_path: Path) -> list[str]:
    path = tmp_path / "calls"
    return path.read_text().splitlines() if path.exists() else []


def test_a_guest_that_ends_proves_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert kvm.works((stand_in(tmp_path, "exit 0"), "-accel", "kvm"), tmp_path / "vmlinuz") is True
    assert calls(tmp_path)[0].startswith("-accel kvm ")
    assert f"-kernel {tmp_path}/vmlinuz" in calls(tmp_path)[0]
    assert capsys.readouterr().err == ""


def test_refusal_is_told_in_the_words_of_qemu(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = stand_in(tmp_path, "echo 'qemu: warning' >&2; echo 'qemu: no CPU of that kind' >&2; exit 1")
    assert kvm.works((program,), tmp_path) is False
    assert capsys.readouterr().err == (
        "rtrun: KVM does not work here, QEMU emulates the processor instead (qemu: no CPU of that kind)\n"
    )


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        # An accelerator that this QEMU was built without, and a device that is not there.
        (("qemu-system-arm", "-M", "virt", "-accel", "kvm"), "invalid accelerator kvm"),
        (("qemu-system-of-nothing",), "No such file or directory"),
    ],
)
def test_the_real_qemu_without_kvm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], reason: str
) -> None:
    assert kvm.works(words, tmp_path / "vmlinuz") is False
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("rtrun: KVM does not work here, QEMU emulates the processor instead (")
    assert reason in line


def test_a_guest_that_hangs_is_ended_and_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kvm, "DEADLINE_S", 0.5)
    # As QEMU does in a system call that never returns, it does not hear SIGTERM.
    program = stand_in(tmp_path, f"trap '' TERM; echo $$ > {tmp_path}/pid; exec sleep 1000")
    for _ in range(2):
        assert kvm.works((program,), tmp_path) is False
    assert capsys.readouterr().err == (
        "rtrun: KVM does not work here, QEMU emulates the processor instead "
        "(a guest that should end at once did not within 0.5 s)\n"
    )
    assert len(calls(tmp_path)) == 1, "the answer is kept while this process runs"
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


@pytest.mark.parametrize(
    ("processor", "status", "expected"),
    [(platform.machine(), 0, ("-cpu", "max", "-accel", "kvm")), (platform.machine(), 1, ("-cpu", "max")),
     ("vax", 0, ("-cpu", "max"))],
)  # fmt: skip
def test_arguments_for_kvm_only_where_it_works(
    tmp_path: Path, processor: str, status: int, expected: tuple[str, ...]
) -> None:
    program = stand_in(tmp_path, f"exit {status}")
    login = qemu.Login(user="root", key="key", host_key="ssh-ed25519 AAAA")
    board = qemu.BoardFile(
        schema=2, machine="m", kernel="vmlinuz", initrd="initrd", dtb=None, cmdline="quiet",
        disk="root.img", disk_format="raw", ssh=login, kernel_release="6.1", packages={},
        qemu=qemu.Emulator(
            binary=program, arguments=["-cpu", "max"], disk_device="d", network_device="n",
            kvm=qemu.Kvm(processor=processor, arguments=["-accel", "kvm"]),
        ),
    )  # fmt: skip
    assert qemu.emulator(board, tmp_path) == (program, *expected)
    platform_here = Platform.VIRTUAL if "kvm" in expected else Platform.EMULATED
    assert qemu.platform_of(board, tmp_path).platform is platform_here
    assert (calls(tmp_path) == []) is (processor == "vax")
