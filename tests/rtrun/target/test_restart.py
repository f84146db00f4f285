"""A target that is restarted on purpose: the real sshd, in a mount namespace where the boot id is a file of ours."""

from dataclasses import replace

import pytest

from rtfiles.errors import UsageError
from rtrun.target import restart
from rtrun.target.errors import TargetError
from rtrun.target.link import Link

pytestmark = pytest.mark.sshd


def test_the_target_answers_as_another_boot(rebooting, remarks):
    with Link(rebooting, remarks.append) as link:
        before = link.boot_id
        restart.restart(link)
        assert link.boot_id != before
        assert link.check(["cat", "/proc/sys/kernel/random/boot_id"]).strip() == link.boot_id


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
