"""The real build of the emulated board: whole in the cache, or not there."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rtfiles import cache
from rtgen import debian
from rtgen.board import sysroot
from rtgen.board.build import build


def test_sysroot_has_no_link_that_leaves_it() -> None:
    folder = sysroot.build("armhf", debian.source())
    links = [path for path in folder.rglob("*") if path.is_symlink()]
    assert len(links) > 100
    assert [path for path in links if path.readlink().is_absolute()] == []


def test_board_is_whole_and_its_name_points_into_the_cache(tmp_path: Path) -> None:
    link = build("qemu-armv7", tmp_path)
    assert link == tmp_path / "qemu-armv7"
    assert link.readlink().is_relative_to(cache.root())
    record = json.loads((link / "board.json").read_text())
    for name in (record["kernel"], record["initrd"], record["disk"], record["ssh"]["key"]):
        assert (link / name).stat().st_size > 0, name
    assert (link / record["ssh"]["key"]).stat().st_mode & 0o077 == 0
    assert "libroscpp4d" in record["packages"]
    assert record["kernel_release"].endswith("-rt-armmp")
    # Nothing changed: the same link to the same place.
    before = link.lstat().st_ino
    build("qemu-armv7", tmp_path)
    assert link.lstat().st_ino == before


@pytest.mark.root
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_build_leaves_nothing(tmp_path: Path, how: signal.Signals) -> None:
    place, temporary = tmp_path / "cache", tmp_path / "tmp"
    temporary.mkdir(mode=0o1777)
    environment = {**os.environ, "META_RT_TESTS_CACHE": str(place), "TMPDIR": str(temporary)}
    process = subprocess.Popen(
        [sys.executable, "-m", "rtgen.cli", "board", "build"],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        process_group=0,
    )
    try:
        # In the middle: mmdebstrap has its folder and downloads into it.
        wait_for(lambda: any(temporary.glob("mmdebstrap.*/var/lib/apt")), process)
        process.send_signal(how)
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    if how != signal.SIGKILL:
        assert process.returncode == 130, errors
        assert errors.decode().strip().splitlines()[-1] == "rtgen: interrupted"
    # Whoever was killed could not wait for mmdebstrap, which was told to end and cleans up.
    wait_for(lambda: not any(temporary.iterdir()))
    entries = [path for path in place.glob("*/*") if not path.name.startswith(".")]
    assert entries == []
    if how != signal.SIGKILL:
        assert list(place.glob("*/.*.tmp-*")) == []
    assert str(tmp_path) not in Path("/proc/self/mounts").read_text()
    assert not (tmp_path / "build").exists()


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[bytes] | None = None) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert process is None or process.poll() is None, "the build ended before it could be interrupted"
        assert time.monotonic() < deadline, "nothing happened within 60 s"
        time.sleep(0.05)
