"""Restarting a target on purpose: so that measurements come from several boots, or from another kernel."""

import time
from collections.abc import Iterable

from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtrun.plan.run import KernelName
from rtrun.target.address import ThisMachine
from rtrun.target.config import Target
from rtrun.target.errors import TargetError
from rtrun.target.link import Link, TargetRebooted

# A board that shuts down answers for some more seconds.
SHUTDOWN_S = 180.0
POLL_S = 1.0


def check_restart(target: Target) -> None:
    """Raise UsageError when this target cannot be restarted."""
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


def check_kernels(target: Target, kernels: Iterable[KernelName]) -> None:
    """Raise UsageError when this target cannot be restarted into each of these kernels."""
    check_restart(target)
    if lacking := [kernel for kernel in kernels if kernel not in target.boot_kernel]:
        raise UsageError(
            f"{target.name}: the campaign asks for the kernel {' and '.join(lacking)}, but nobody said how the target "
            "boots it: add boot_kernel to the target file, or build the board with both kernels "
            f"({as_called('rtgen')} board build --kernel both), or leave the kernel out of kernels in the campaign"
        )


def restart(link: Link, kernel: KernelName | None = None) -> None:
    """Restart the target, into a kernel where one is named, and wait until it answers as another boot.

    What was started there is gone. Raises UsageError when it cannot be restarted so, TargetError when it goes on as the
    same boot, or does not come back. The caller checks which kernel it runs then.
    """
    check_restart(link.target)
    if kernel is not None:
        check_kernels(link.target, [kernel])
        link.do(link.target.boot_kernel[kernel])
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
