"""The kernel trace of a run that asks for one: set up before it, taken down after it."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath

from rtrun.plan.suites import Value
from rtrun.target.errors import StillMeasuring, TargetError
from rtrun.target.link import OUT_OF_REACH, Link

OPTIONS = ("break_trace_us", "trace_threshold_us")
# So that the timestamps of a trace are those of the samples.
CLOCKS = {"raw": "mono_raw", "monotonic": "mono"}


@contextlib.contextmanager
def tracing(link: Link, scripts: PurePosixPath, parameters: Mapping[str, Value]) -> Iterator[None]:
    """Keep the kernel trace that the suites copy from recording while the context lasts, if the parameters ask for one.

    Raises TargetError when the target cannot trace. While the target is out of reach its trace stays, as the run does:
    whoever picks that up takes it down, and so does the next campaign.
    """
    if all(parameters.get(option) is None for option in OPTIONS):
        yield
        return
    script = str(scripts / "trace.sh")
    clock = CLOCKS[str(parameters["clock"])]
    link.check([script, "up", clock])
    try:
        yield
    except (*OUT_OF_REACH, StillMeasuring):
        raise
    except BaseException:
        with contextlib.suppress(TargetError):
            link.run([script, "down"])
        raise
    link.run([script, "down"])
