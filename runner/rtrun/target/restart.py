"""Restarting a target on purpose, so that measurements come from several boots."""

import time

from rtfiles.errors import UsageError
from rtrun.target.address import ThisMachine
from rtrun.target.errors import TargetError
from rtrun.target.link import Link, TargetRebooted

# A board that shuts down answers for some more seconds.
SHUTDOWN_S = 180.0
POLL_S = 1.0


def check_restart(link: Link) -> None:
    """Raise UsageError when this target cannot be restarted."""
    if isinstance(link.target.address, ThisMachine):
        raise UsageError(
            f"{link.target.name}: the campaign asks for several boots, but the runner cannot restart the machine "
            "that it runs on: ask for boots: 1, or measure this machine from another one (kind: ssh)"
        )
    if link.target.restart is None:
        raise UsageError(
            f"{link.target.name}: the campaign asks for several boots, but the target file does not say how to restart "
            "the target: add restart: [systemctl, reboot], or whatever restarts it"
        )


def restart(link: Link) -> None:
    """Restart the target and wait until it answers as another boot; what was started there is gone.

    Raises TargetError when it goes on as the same boot, or does not come back.
    """
    check_restart(link)
    request = link.target.restart
    assert request is not None
    before = link.boot_id
    deadline = time.monotonic() + SHUTDOWN_S
    # A power cut must not undo what was written there.
    link.check(["sync"], deadline_s=SHUTDOWN_S)
    link.do(request)
    while link.boot_id == before:
        # The connection may hang from now on: the board that it leads to no longer exists.
        link.drop()
        if time.monotonic() > deadline:
            raise TargetError(
                f"{link.target.address}: still the same boot {SHUTDOWN_S:.0f} s after it was told to restart: "
                "check restart in the target file"
            )
        time.sleep(POLL_S)
        try:
            link.run(["true"])
        except TargetRebooted:
            return
