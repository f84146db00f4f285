"""Restart a target on purpose, to measure on several boots or another kernel."""

import time
from collections.abc import Collection

from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtrun.plan.run import KernelName
from rtrun.targets.address import ThisMachine
from rtrun.targets.config import Target
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link, TargetRebooted

# A board that shuts down answers for some more seconds.
SHUTDOWN_S = 180.0  #: waiting for a target to go down when it restarts
POLL_S = 1.0


def check_restart(target: Target, kernels: Collection[KernelName] = ()) -> None:
    """Raise UsageError when this target cannot be restarted, or not into each of these kernels."""
    if isinstance(target.address, ThisMachine):
        raise UsageError(
            f"{target.name}: the campaign asks for several boots, but the runner cannot restart the machine "
            "that it runs on: ask for one boot and one kernel, or measure this machine from another one (kind: ssh)"
        )
    if target.restart is None:
        raise UsageError(
            f"{target.name}: the campaign asks for several boots, but the target file does not say how to restart "
            "the target: add restart: [systemctl, reboot], or whatever restarts it"
        )
    if lacking := [kernel for kernel in kernels if kernel not in target.boot_kernel]:
        raise UsageError(
            f"{target.name}: the campaign asks for the kernel {' and '.join(lacking)}, but nobody said how the target "
            "boots it: add boot_kernel to the target file, or build the board with both kernels "
            f"({as_called('rtgen')} board build --kernel both), or leave the kernel out of kernels in the campaign"
        )


def restart(link: Link, kernel: KernelName | None = None) -> None:
    """Restart the target, into a kernel if one is named, and wait until it answers with another boot.

    Programs that were started there are gone. Raises UsageError when it cannot be restarted like this, TargetError when
    it stays in the same boot or does not come back. The caller checks which kernel runs afterwards.
    """
    check_restart(link.target, () if kernel is None else (kernel,))
    if kernel is not None:
        link.do(link.target.boot_kernel[kernel])
    # A power cut must not undo what was written there.
    link.check(["sync"], deadline_s=SHUTDOWN_S)
    request = link.target.restart
    assert request is not None
    link.expect_boot()
    link.do(request)
    deadline = time.monotonic() + SHUTDOWN_S
    while not _is_restarted(link):
        if time.monotonic() > deadline:
            raise TargetError(
                f"{link.target.address}: still the same boot {SHUTDOWN_S:.0f} s after it was told to restart: "
                "check restart in the target file"
            )
        time.sleep(POLL_S)


def _is_restarted(link: Link) -> bool:
    """Whether the target answers with another boot than the link has seen before."""
    # The old connection may lead to a board that no longer exists, and would hang.
    link.drop()
    try:
        link.do(lambda _: None)
    except TargetRebooted:
        return True
    return False
