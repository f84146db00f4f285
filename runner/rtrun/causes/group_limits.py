"""Parts of the time that a control group's limit took. A trace alone cannot distinguish it from the kernel's own
limit."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from rtrun.causes.parts import Cause, Kind, Part
from rtrun.causes.reconstruction import NORMAL_PRIO
from rtrun.causes.timeline import State
from rtrun.results.record import RunRecord
from rtrun.targets.inspection.control_groups import KERNEL_RUNTIME_US, ControlGroup

# No CPU takes this long to leave an idle state.
IDLE_EXIT_MAX_NS = 1_000_000


def with_groups(parts: Sequence[Part], record: RunRecord, prios: Mapping[int, int]) -> tuple[Part, ...]:
    """The same parts, with the control group and its limit named in those that a limit took.

    A group throttles a real-time thread if the group's limit is below the kernel's, and any other thread if cpu.stat
    counted it. `prios` are the priorities of threads.
    """
    rt_group, quota_group = _rt_limited(record), _throttled(record)
    return tuple(
        _with_group(part, None if part.pid is None else prios.get(part.pid), rt_group, quota_group) for part in parts
    )


def uses_up_quota(record: RunRecord) -> bool:
    """Whether a quota of the program's control groups was used up during a run."""
    return bool(_throttled(record))


def limits(record: RunRecord) -> tuple[str, ...]:
    """The limits of the control groups that a run's programs were in, a sentence each."""
    return tuple(f"{record.run}: {_sentence(group, limit)}" for group, limit in _limited(record))


def _with_group(part: Part, prio: int | None, rt_group: str, quota_group: str) -> Part:
    if part.cause.kind is Kind.THROTTLED and rt_group:
        return replace(part, cause=Cause(kind=Kind.GROUP, name=rt_group))
    is_normal = prio is not None and prio >= NORMAL_PRIO
    # A CPU may have become idle before its group was throttled. It then stays idle, and no event shows why.
    left_idle = part.cause.kind is Kind.IDLE_EXIT and part.length_ns > IDLE_EXIT_MAX_NS and part.state is State.WAITING
    if part.cause.kind is Kind.GROUP or (left_idle and is_normal and quota_group):
        return replace(part, cause=Cause(kind=Kind.GROUP, name=quota_group or part.cause.name))
    return part


def _groups(record: RunRecord) -> list[ControlGroup]:
    """The control groups of all programs, each once."""
    groups = {(group.version, group.path): group for program in record.programs for group in program.control_groups}
    return list(groups.values())


def _kernel_us(record: RunRecord) -> int:
    """The microseconds of each second that the kernel leaves to real-time threads, as the sampler saw; -1: all."""
    seen = record.in_effect.sched_rt_runtime_us
    return KERNEL_RUNTIME_US if not seen else -1 if -1 in seen else max(seen)


def _limited(record: RunRecord) -> Iterator[tuple[ControlGroup, str]]:
    for group in _groups(record):
        yield from ((group, limit) for limit in (group.rt_limit(_kernel_us(record)), group.quota) if limit)


def _rt_limited(record: RunRecord) -> str:
    """The control group with the lowest limit for real-time threads, and the limit; empty if there is none."""
    named = [
        ((group.rt_runtime_us or 0) / (group.rt_period_us or 1), f"{group.path} ({limit})")
        for group in _groups(record)
        if (limit := group.rt_limit(_kernel_us(record)))
    ]
    return min(named)[1] if named else ""


def _throttled(record: RunRecord) -> str:
    """The control group that was throttled for longest during the run, and its limit; empty if there is none."""
    named = [
        (group.throttled.throttled_ns, f"{group.path} ({group.quota})")
        for group in _groups(record)
        if group.quota and group.throttled.throttled
    ]
    return max(named)[1] if named else ""


def _sentence(group: ControlGroup, limit: str) -> str:
    if limit != group.quota:
        return f"control group {group.path} leaves to real-time threads {limit}"
    seen = group.throttled
    return (
        f"control group {group.path} leaves to threads of policy OTHER {limit}; throttled in {seen.throttled} of "
        f"{seen.periods} periods, {seen.throttled_ns / 1e9:.3g} s in all"
    )
