"""The order in which the runs of a campaign on several kernels are measured."""

import itertools
from collections.abc import Sequence

from rtrun.plan.run import KernelName, Run


def order_by_kernel(runs: Sequence[Run], kernels: Sequence[KernelName]) -> tuple[Run, ...]:
    """Order runs by repeat, and those of one repeat by kernel; otherwise they keep their order.

    From one repeat to the next the order of the kernels is reversed (standard, rt, rt, standard): a steady drift of the
    target then moves the results of both by nearly the same. With less than two kernels nothing changes.
    """
    if len(kernels) < 2:
        return tuple(runs)
    numbers = {kernel: number for number, kernel in enumerate(kernels)}

    def place(run: Run) -> tuple[int, int]:
        number = numbers[run.kernel] if run.kernel else 0
        return run.repeat, number if run.repeat % 2 else -number

    return tuple(sorted(runs, key=place))


def blocks(runs: Sequence[Run], *, is_shared: bool = False) -> list[tuple[Run, ...]]:
    """The runs in their order, divided into what is measured together, on one board and one boot.

    A block is one repeat on one kernel: what differs from boot to boot is not taken for an effect of the kernel then.
    The runs of a campaign with less than two kernels are one block. Where boards share a campaign (`is_shared`), a
    block is one repeat on all kernels, so that what is compared is measured on the same board; a campaign of one
    repeat is shared out run by run.
    """
    if is_shared:
        by_repeat: dict[object, list[Run]] = {}
        # A run that keeps traces is compared with its twin, and takes its limit from its warm-up.
        is_whole = any(run.repeat > 1 or run.trace for run in runs)
        for run in runs:
            by_repeat.setdefault(run.repeat if is_whole else run.name, []).append(run)
        return [tuple(block) for block in by_repeat.values()]
    if len({run.kernel for run in runs}) < 2:
        return [tuple(runs)]
    return [tuple(block) for _, block in itertools.groupby(runs, key=lambda run: (run.repeat, run.kernel))]
