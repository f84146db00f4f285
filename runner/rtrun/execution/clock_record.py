"""The clock a run was measured with: its name, the event device that wakes timers, and its step."""

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtrun.results.output import Record
from rtrun.results.record import Clock
from rtrun.targets.inspection.facts import TargetState

# Steps of clocksources that are far coarser than the measured times, in ns, rounded up. The step of a finer clock is
# only seen by reading it in a loop, as the measuring programs do.
_COARSE_NS = {
    # OMAP's 32 768 Hz counter: the only clocksource of a PandaBoard ES under a mainline kernel.
    "32k_counter": 30_518,
}


def record(state: TargetState, seen_ns: Iterable[int]) -> Clock:
    """The clock of a run: its source and event device as the kernel names them, and its step.

    `state` is the target's state before the run. `seen_ns` holds, for each program, the smallest nonzero difference
    that it saw between two readings. The step is the largest of these, but at least the known step of the clocksource;
    None when neither is known.
    """
    source = state.clocksource
    steps = [step for step in seen_ns if step > 0]
    if isinstance(source, str) and source in _COARSE_NS:
        steps.append(_COARSE_NS[source])
    return Clock(source=source, event=state.clockevent, step_ns=max(steps, default=None))


def steps_seen(folder: Path, outputs: Iterable[str], records: Mapping[str, Record]) -> list[int]:
    """The clock steps that programs wrote down in ``<output>.json``, in ns; a program of 2014 writes none.

    `records` holds the files that were read before, by output.
    """
    steps = []
    for output in outputs:
        with contextlib.suppress(UsageError):
            record = records.get(output) or read_json(folder / f"{output}.json", Record)
            steps.append(record.in_effect.clock_step_ns)
    return steps
