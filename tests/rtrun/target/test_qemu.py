"""What the real QEMU refuses is told in one line, in its own words."""

import json
from pathlib import Path

import pytest

from rtrun.cli import main

pytestmark = pytest.mark.qemu

BOARD = {
    "schema": 2, "machine": "nonsense", "kernel": "vmlinuz", "initrd": "initrd", "dtb": None, "cmdline": "quiet",
    "disk": "root.img", "disk_format": "raw", "kernel_release": "6.1", "packages": {},
    "ssh": {"user": "root", "key": "key", "host_key": "ssh-ed25519 AAAA"},
}  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["-M", "virt", "-cpu", "nonsense"], "unable to find CPU model 'nonsense'"),
        (["-M", "nonsense"], "unsupported machine type"),
        (["--nonsense"], "invalid option"),
    ],
)
def test_arguments_that_make_no_sense(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    for name in ("vmlinuz", "initrd", "root.img"):
        (tmp_path / name).write_bytes(bytes(1 << 20))
    emulator = {
        "binary": "qemu-system-arm", "arguments": arguments, "kvm": None,
        "disk_device": "virtio-blk-device", "network_device": "virtio-net-device",
    }  # fmt: skip
    (tmp_path / "board.json").write_text(json.dumps(BOARD | {"qemu": emulator}))
    target = tmp_path / "target.yml"
    target.write_text("{schema: 1, name: nonsense, kind: qemu, board: .}")
    assert main(["probe", "--target", str(target)]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("rtrun: QEMU did not start: ")
    assert reason in line
