"""What the real QEMU refuses is told in one line, in its own words."""

import json
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest

from rtrun.cli import main
from rtrun.targets.qemu import emulator as qemu

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


def test_a_monitor_that_is_slow_to_listen_is_waited_for(tmp_path: Path) -> None:
    """QEMU makes the file of its monitor, and listens there a moment later."""
    monitor = tmp_path / "monitor"
    port = "TCP[HOST_FORWARD]  13  127.0.0.1  40022  10.0.2.15  22"

    def answer(server: socket.socket) -> None:
        time.sleep(0.2)
        server.bind(str(monitor))
        time.sleep(0.2)
        server.listen()
        client, _ = server.accept()
        with client, client.makefile("rwb") as stream:
            for reply in ({"QMP": {}}, {"return": {}}, {"return": port}):
                stream.write(json.dumps(reply).encode() + b"\n")
            stream.flush()
            stream.read()

    with socket.socket(socket.AF_UNIX) as server:
        threading.Thread(target=answer, args=(server,), daemon=True).start()
        with subprocess.Popen(["sleep", "60"]) as process:
            try:
                assert qemu._forwarded_port(process, monitor, tmp_path / "stderr") == 40022
            finally:
                process.kill()
