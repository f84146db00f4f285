"""How much CPU time control groups let a program have: read from cgroups.sh.

A group of version 1 limits real-time threads (cpu.rt_runtime_us, kernels with CONFIG_RT_GROUP_SCHED) and, separately,
threads of policy OTHER (cpu.cfs_quota_us). A group of version 2 limits only the latter (cpu.max).
See Documentation/scheduler/sched-rt-group.rst and sched-bwc.rst.
"""

import re
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from pydantic import Field, ValidationError

from rtfiles.config import Config
from rtfiles.untrusted import whole_number
from rtrun.kinds.limits import Count, PeriodUs, QuotaUs, RtRuntimeUs, TimeNs
from rtrun.targets.deploy import ON_TARGET

SCRIPT = ON_TARGET / "cgroups.sh"
# Groups are no deeper than folders: PATH_MAX.
PATH_MAX = 4096  #: characters of the path of a control group
GROUPS_MAX = 256  #: control groups above a program
# The default of sched_rt_period_us, and how much of it real-time threads may have by default.
KERNEL_PERIOD_US, KERNEL_RUNTIME_US = 1_000_000, 950_000
_NANOSECONDS = {"throttled_time": 1, "throttled_usec": 1000}
_FIELDS = {
    "cpu.rt_runtime_us": "rt_runtime_us",
    "cpu.rt_period_us": "rt_period_us",
    "cpu.cfs_quota_us": "quota_us",
    "cpu.cfs_period_us": "quota_period_us",
}


class Throttling(Config):
    """Counts of cpu.stat since the group was made: all periods, those that used up the quota, and throttled time."""

    periods: Count
    throttled: Count
    throttled_ns: TimeNs


class ControlGroup(Config):
    """A control group of a program, or one above it. None: no such limit, or the kernel does not have it."""

    version: Literal[1, 2]
    path: str = Field(max_length=PATH_MAX)
    rt_runtime_us: RtRuntimeUs | None = None
    rt_period_us: PeriodUs | None = None
    quota_us: QuotaUs | None = None
    quota_period_us: PeriodUs | None = None
    before: Throttling | None = None
    """The counts before the program was started."""
    after: Throttling | None = None

    @property
    def throttled(self) -> Throttling:
        """What was counted while the program ran."""
        none = Throttling(periods=0, throttled=0, throttled_ns=0)
        old, new = self.before or none, self.after or self.before or none
        return Throttling(
            periods=max(0, new.periods - old.periods),
            throttled=max(0, new.throttled - old.throttled),
            throttled_ns=max(0, new.throttled_ns - old.throttled_ns),
        )

    def rt_limit(self, kernel_us: int = KERNEL_RUNTIME_US) -> str | None:
        """Its limit for real-time threads, with its unit, if that is lower than the limit of the whole kernel."""
        if self.rt_runtime_us is None or self.rt_runtime_us < 0 or self.rt_period_us is None:
            return None
        if kernel_us >= 0 and self.rt_runtime_us * KERNEL_PERIOD_US >= kernel_us * self.rt_period_us:
            return None
        return f"cpu.rt_runtime_us {self.rt_runtime_us} of {self.rt_period_us} us"

    @property
    def quota(self) -> str | None:
        """Its limit for threads of policy OTHER, with its unit."""
        if self.quota_us is None or self.quota_period_us is None:
            return None
        return f"{'cpu.cfs_quota_us' if self.version == 1 else 'cpu.max'} {self.quota_us} of {self.quota_period_us} us"


def parse(text: str) -> list[ControlGroup]:
    """Read the output of cgroups.sh. A group that the kernel could not report like this is left out."""
    groups = []
    for block in re.split(r"^group ", text, flags=re.MULTILINE)[1 : GROUPS_MAX + 1]:
        head, *lines = block.splitlines()
        version, _, path = head.partition(" ")
        try:
            limits = {"version": whole_number(version), "path": path, **_limits(lines)}
            groups.append(ControlGroup.model_validate(limits))
        except (ValidationError, ValueError):
            continue
    return groups


def parse_around(text: str) -> list[ControlGroup]:
    """Read what supervise.sh keeps of a program: the output of cgroups.sh before it, and again after it."""
    before, _, after = text.partition("== after\n")
    ended = {(group.version, group.path): group.before for group in parse(after)}
    return [group.model_copy(update={"after": ended.get((group.version, group.path))}) for group in parse(before)]


def _limits(lines: Sequence[str]) -> dict[str, Any]:
    limits: dict[str, Any] = {}
    counts: dict[str, int] = {}
    for line in lines:
        name, _, value = line.partition(" ")
        if name in _FIELDS:
            number = whole_number(value, lowest=-1)
            limits[_FIELDS[name]] = None if name == "cpu.cfs_quota_us" and number < 0 else number
        elif name == "cpu.max":
            quota, _, period = value.partition(" ")
            limits["quota_us"] = None if quota == "max" else whole_number(quota)
            limits["quota_period_us"] = whole_number(period)
        elif name == "cpu.stat":
            what, _, number_text = value.partition(" ")
            counts[what] = whole_number(number_text)
    time_ns = [counts[name] * factor for name, factor in _NANOSECONDS.items() if name in counts]
    if time_ns and {"nr_periods", "nr_throttled"} <= counts.keys():
        limits["before"] = Throttling(
            periods=counts["nr_periods"], throttled=counts["nr_throttled"], throttled_ns=time_ns[0]
        )
    return limits


def limits_of(groups: Iterable[ControlGroup], kernel_us: int = KERNEL_RUNTIME_US) -> list[str]:
    """The limits of groups, one line each: group, file, value and unit."""
    return [f"{group.path}: {limit}" for group in groups for limit in (group.rt_limit(kernel_us), group.quota) if limit]
