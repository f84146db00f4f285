"""The kernel trace of a run that asks for one: set up before the run, removed after it."""

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from rtfiles.config import Config, load_own, matching
from rtrun.plan.suites import Value
from rtrun.targets.errors import TargetError

if TYPE_CHECKING:
    from rtrun.targets.link import Link

OPTIONS = ("break_trace_us", "trace_threshold_us")
# The trace uses the clock of the samples, so that their timestamps can be compared.
CLOCKS = {"raw": "mono_raw", "monotonic": "mono"}
# The function that the timer of a sleeping thread calls: what a trace is read with.
FUNCTIONS = ("hrtimer_wakeup",)
DATA = Path(__file__).with_name("trace_events.yml")


class TraceEvents(Config):
    """trace_events.yml: each event is a folder below `events` of tracefs, a group or one event of it."""

    schema_number: Literal[1] = Field(alias="schema")
    events: list[Annotated[str, matching("[a-z0-9_]+(/[a-z0-9_]+)?", "an event or a group, as sched/sched_switch")]]


def read_events() -> list[str]:
    """The events of a trace, as far as the kernel knows them."""
    return load_own(DATA, TraceEvents).events


def read_symbols(link: "Link", functions: Sequence[str] = FUNCTIONS) -> dict[int, str]:
    """These functions of the kernel by address; empty if the kernel hides the addresses."""
    names = "|".join(functions)
    answer = link.run(["grep", "-E", f" [tT] ({names})$", "/proc/kallsyms"]).stdout
    found = re.findall(rf"^([0-9a-f]{{8,16}}) [tT] ({names})$", answer, re.MULTILINE | re.ASCII)
    return {int(address, 16): name for address, name in found if int(address, 16)}


@contextlib.contextmanager
def tracing(
    link: "Link", scripts: PurePosixPath, parameters: Mapping[str, Value], may_run_go_on: Callable[[], bool]
) -> Iterator[None]:
    """Record the kernel trace that the suites copy from while the context lasts, if the parameters ask for one.

    Raises TargetError when the target cannot trace. If the run may go on after an error, its trace stays; the call that
    picks up the run removes the trace, and so does the next campaign.
    """
    if all(parameters.get(option) is None for option in OPTIONS):
        yield
        return
    script = str(scripts / "trace.sh")
    clock = CLOCKS[str(parameters["clock"])]
    link.check([script, "up", clock, *read_events()])
    try:
        yield
    except BaseException:
        with contextlib.suppress(TargetError):
            if not may_run_go_on():
                link.run([script, "down"])
        raise
    link.run([script, "down"])
