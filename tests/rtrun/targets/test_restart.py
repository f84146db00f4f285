"""A target that is restarted on purpose: the real sshd, in a mount namespace where the boot id is a file of ours."""

import shutil
from dataclasses import replace

import pytest

from conftest import BOOT_ID, seeing, serve
from rtfiles.errors import UsageError
from rtrun.targets import restart
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

pytestmark = pytest.mark.sshd


def test_the_target_answers_as_another_boot(rebooting, remarks):
    with Link(rebooting, remarks.append) as link:
        before = link.boot_id
        restart.restart(link)
        assert link.boot_id != before
        assert link.check(["cat", "/proc/sys/kernel/random/boot_id"]).strip() == link.boot_id


def test_what_was_written_is_on_its_disk_before_the_power_is_cut(loopback, tmp_path, remarks):
    """A board in QEMU loses what is not: with half of a deployed file, and the kernel that was chosen."""
    boot, calls = tmp_path / "boot_id", tmp_path / "calls"
    boot.write_text("before\n")
    sync = tmp_path / "sync"
    sync.write_text(f"#!/bin/sh\necho sync >>{calls}\n")
    sync.chmod(0o755)

    def note(word, boot_id="before"):
        with calls.open("a") as stream:
            stream.write(f"{word}\n")
        boot.write_text(f"{boot_id}\n")

    (tmp_path / "sshd").mkdir()
    with serve(tmp_path / "sshd", seeing({BOOT_ID: boot, shutil.which("sync"): sync})) as server:
        target = replace(
            loopback,
            address=server.address,
            boot_kernel={"rt": lambda _: note("choose")},
            restart=lambda _: note("restart", "after"),
        )
        with Link(target, remarks.append) as link:
            restart.restart(link, "rt")
    assert calls.read_text().split() == ["choose", "sync", "restart"]


def test_a_target_that_does_not_restart_is_an_error(rebooting, remarks, monkeypatch):
    monkeypatch.setattr(restart, "SHUTDOWN_S", 2.0)
    target = replace(rebooting, restart=lambda connection: None)
    with Link(target, remarks.append) as link, pytest.raises(TargetError, match="still the same boot 2 s after"):
        restart.restart(link)


def test_a_command_that_fails_is_an_error(rebooting, remarks):
    target = replace(rebooting, restart=lambda connection: print(connection.check(["false"])))
    with Link(target, remarks.append) as link, pytest.raises(TargetError, match="false"):
        restart.restart(link)


def test_without_a_word_on_how_it_is_refused(rebooting, remarks):
    with (
        Link(replace(rebooting, restart=None), remarks.append) as link,
        pytest.raises(UsageError, match=r"add restart: \[systemctl, reboot\]"),
    ):
        restart.restart(link)
