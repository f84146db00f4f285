"""What was asked of a run beside what was in effect: read from what sample.sh saw, compared, told apart.

A look is what sample.sh found at one moment. All of it comes from the target: what is not as sample.sh writes it is a
UsageError.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rtfiles.errors import UsageError
from rtrun.plan import conditions, suites
from rtrun.plan.campaign import Run
from rtrun.plan.conditions import Background, cpu_set
from rtrun.results.record import Observed, Requested, Rival
from rtrun.results.samples import BESIDE, Record
from rtrun.target.inspection import POLICIES

# A program may take this long to get its policy; before, it is only told, not held against it.
STARTING_S = 10.0
# Looks are this far apart: a program may have begun so much earlier than it was first seen.
APART_S = 2.0
_TOO_SHORT = "the sampler's first look comes 1 s after its start; measure longer"
REPORTED_RIVALS = 32

State = tuple[str, int, frozenset[int]]
"""Policy, priority and CPUs of a thread."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What was in effect at one moment; `threads` by program, `loads` by program: processes and CPUs."""

    uptime_s: float
    load_1min: float
    temperature_mc: tuple[int, ...]
    frequency_khz: tuple[int, ...]
    busy: int
    """Ticks of all CPUs, since the boot, that were not idle, and all ticks."""
    ticks: int
    threads: Mapping[str, tuple[State, ...]] = field(default_factory=dict)
    loads: Mapping[str, tuple[int, frozenset[int]]] = field(default_factory=dict)
    rivals: frozenset[tuple[str, str, int]] = frozenset()
    governor: tuple[str, ...] = ()
    sched_rt_runtime_us: int | None = None


def read_looks(text: str) -> list[Look]:
    """Read what sample.sh printed; a last line that was cut off is left out. Raises UsageError."""
    looks: list[Look] = []
    block: list[list[str]] = []
    for number, line in enumerate(text[: text.rfind("\n") + 1].splitlines(), start=1):
        words = line.split()
        try:
            if words[:1] == ["at"]:
                looks.append(_at(words, looks[-1] if looks else None))
                block = []
            elif words == ["end"]:
                looks[-1] = _with(looks[-1], block)
            else:
                block.append(words)
        except (ValueError, IndexError, KeyError):
            raise UsageError(f"sampler.stdout:{number}: not what sample.sh writes: {line[:80]!r}") from None
    return looks


def _at(words: list[str], before: Look | None) -> Look:
    # In /proc/stat: user nice system idle iowait irq softirq steal (proc(5)); what follows is in these already.
    ticks = [int(word) for word in words[6:14]]
    gauges: dict[str, Any] = {
        "uptime_s": float(words[1]),
        "load_1min": float(words[2]),
        "temperature_mc": _numbers(words[3]),
        "frequency_khz": _numbers(words[4]),
        "busy": sum(ticks) - ticks[3] - ticks[4],
        "ticks": sum(ticks),
    }
    return replace(before, **gauges) if before else Look(**gauges)


def _with(look: Look, block: list[list[str]]) -> Look:
    threads: dict[str, tuple[State, ...]] = {}
    loads: dict[str, tuple[int, frozenset[int]]] = {}
    rivals: set[tuple[str, str, int]] = set()
    governor: tuple[str, ...] = ()
    runtime_us: int | None = None
    for words in block:
        if words[0] == "thread":
            if " ".join(words[6:]) in BESIDE:
                continue
            state = (POLICIES[int(words[3])], int(words[4]), _cpus(words[5]))
            threads[words[1]] = (*threads.get(words[1], ()), state)
        elif words[0] == "load":
            loads[words[1]] = (int(words[2]), _cpus(words[3]))
        elif words[0] == "rival":
            rivals.add((" ".join(words[4:]), POLICIES[int(words[2])], int(words[3])))
        elif words[0] == "governor":
            governor = () if words[1] == "-" else tuple(words[1].split(","))
        elif words[0] == "sched_rt_runtime_us":
            runtime_us = None if words[1] == "-" else int(words[1])
    return replace(
        look,
        threads=threads,
        loads=loads,
        rivals=frozenset(rivals),
        governor=governor,
        sched_rt_runtime_us=runtime_us,
    )


def _numbers(word: str) -> tuple[int, ...]:
    return () if word == "-" else tuple(int(number) for number in word.split(","))


def _cpus(word: str) -> frozenset[int]:
    return frozenset() if word == "-" else frozenset(cpu_set(word))


def requested(run: Run, beside: Sequence[Background]) -> Requested:
    """What a run asks for, under the names that `observed` uses; None where it asks for nothing."""
    has_policy = "policy" in run.parameters
    real_time = run.parameters.get("policy", "0") != "0"
    return Requested(
        policy=(str(run.parameters["policy"]) if real_time else "OTHER") if has_policy else None,
        priority=(int(run.parameters["priority"] or 0) if real_time else 0) if has_policy else None,
        cpus=_list(run.parameters.get("cpu")),
        loads={each.program.name: each.processes for each in beside},
        load_cpus=_list(run.settings.get("load_cpu")),
        governor=str(run.settings.get("governor") or "") or None,
        busy_percent=_busy_floor(run),
    )


def _busy_floor(run: Run) -> int | None:
    floor = conditions.conditions().conditions[run.condition].busy_percent
    return floor if floor and not run.settings.get("load_cpu") else None


def _list(cpus: suites.Value) -> list[int] | None:
    return sorted(cpu_set(str(cpus))) if cpus else None


def observed(run: Run, looks: Sequence[Look], records: Mapping[str, Record]) -> Observed:
    """What was in effect while the suite measured: every value that was seen, of loads the fewest processes.

    `records`, by output, are the suite's own word on its threads.
    """
    seen = [look for look in looks if look.threads]
    states = [state for _, _, threads in _measuring(run, looks, records) for state in threads]
    states += [state for record in records.values() for state in _threads(record)]
    names = sorted({name for look in seen for name in look.loads})
    rivals = sorted({rival for look in seen for rival in look.rivals}, key=lambda rival: (-rival[2], rival[0]))
    return Observed(
        policy=sorted({policy for policy, _, _ in states}),
        priority=sorted({priority for _, priority, _ in states}),
        cpus=sorted({cpu for _, _, cpus in states for cpu in cpus}),
        loads={name: min(look.loads[name][0] if name in look.loads else 0 for look in seen) for name in names},
        load_cpus=sorted({cpu for look in seen for _, cpus in look.loads.values() for cpu in cpus}),
        governor=sorted({name for look in seen for name in look.governor}),
        busy_percent=_busy_percent(seen),
        sched_rt_runtime_us=sorted({look.sched_rt_runtime_us for look in seen if look.sched_rt_runtime_us}),
        temperature_mc=_range(value for look in seen for value in look.temperature_mc),
        frequency_khz=_range(value for look in seen for value in look.frequency_khz),
        load_1min=_range(look.load_1min for look in seen),
        rivals=[
            Rival(name=name, policy=policy, priority=priority) for name, policy, priority in rivals[:REPORTED_RIVALS]
        ],
        looks=len(seen),
    )


def _busy_percent(looks: Sequence[Look]) -> float | None:
    ticks = looks[-1].ticks - looks[0].ticks if looks else 0
    return round(100 * (looks[-1].busy - looks[0].busy) / ticks, 1) if ticks > 0 else None


def _range(values: Iterable[float]) -> list[int | float] | None:
    found = list(values)
    return [min(found), max(found)] if found else None


def _threads(record: Record) -> list[State]:
    return [
        (thread.policy, thread.priority, frozenset(thread.cpus))
        for thread in record.in_effect.threads
        if thread.name not in BESIDE
    ]


def mismatch(
    run: Run, beside: Sequence[Background], looks: Sequence[Look], records: Mapping[str, Record]
) -> str | None:
    """Say what was not in effect as asked for, the first thing found, or None. `records` by output."""
    asked = requested(run, beside)
    right = _judge_of(run)
    for output, record in records.items():
        if not right(_threads(record)):
            return f"{output}: asked for {_told(asked)}, in effect was {_seen(_threads(record))}"
    for program, after_s, threads in _measuring(run, looks, records):
        if not right(threads):
            return f"{program}: asked for {_told(asked)}, after {after_s:.0f} s in effect was {_seen(threads)}"
    seen = [look for look in looks if look.threads]
    threads_seen = [threads for look in seen for threads in look.threads.values()]
    if (asked.loads or asked.governor) and not seen:
        return f"nobody saw condition {run.condition} in effect: {_TOO_SHORT}"
    real_time = asked.policy not in (None, "OTHER")
    # What writes no json itself must have been seen.
    if (real_time or asked.cpus) and not records and not any(map(right, threads_seen)):
        return f"nobody saw {_told(asked)} in effect: {_TOO_SHORT}"
    for name, processes in asked.loads.items():
        for look in seen:
            there, cpus = look.loads.get(name, (0, frozenset()))
            if there < processes:
                return f"condition {run.condition}: {name} had {there} of {processes} processes while the suite ran"
            if asked.load_cpus and not name.startswith("hold-") and not cpus <= set(asked.load_cpus):
                return f"condition {run.condition}: {name} ran on CPUs {sorted(cpus)}, not on {asked.load_cpus}"
    busy, floor = _busy_percent(seen), asked.busy_percent
    if floor is not None and busy is not None and busy < floor:
        return f"condition {run.condition}: the CPUs were {busy} % busy, below {floor} %"
    if asked.governor and (other := {name for look in seen for name in look.governor} - {asked.governor}):
        return f"asked for the governor {asked.governor}, in effect was {', '.join(sorted(other))}"
    return None


def _measuring(
    run: Run, looks: Sequence[Look], records: Mapping[str, Record]
) -> Iterator[tuple[str, float, tuple[State, ...]]]:
    """Yield the threads of each program at each look that counts, and the time since its first, in seconds.

    A program that starts has no priority yet, and once it has measured, or stopped early, it gives it up: such looks
    before it first was as asked for, and after it last was, do not count, unless there is no such excuse for them.
    """
    right = _judge_of(run)
    complete = all(record.complete for record in records.values())
    for program in dict.fromkeys(name for look in looks for name in look.threads):
        of_it = [(look.uptime_s, look.threads[program]) for look in looks if program in look.threads]
        first_s, rights = of_it[0][0], [uptime_s for uptime_s, threads in of_it if right(threads)]
        begun_s = min([first_s + STARTING_S, *rights])
        given_up_s = max([first_s - APART_S + run.expected_s if complete else 0.0, *rights])
        for uptime_s, threads in of_it:
            if begun_s <= uptime_s <= given_up_s:
                yield program, uptime_s - first_s, threads


def _judge_of(run: Run) -> Callable[[Iterable[State]], bool]:
    """Return whether threads are as asked for: all of them, or as many as the run's scope is about."""
    asked = requested(run, [])

    def fits(state: State) -> bool:
        policy, priority, cpus = state
        allowed = asked.cpus is None or cpus <= set(asked.cpus)
        return allowed and (asked.policy is None or (policy, priority) == (asked.policy, asked.priority))

    if "threads" in run.parameters:  # cyclictest: its main thread only waits
        least = int(run.parameters["threads"] or 1)
        return lambda threads: sum(map(fits, threads)) >= least
    if run.parameters.get("rt_scope") == "measuring-thread":
        return lambda threads: any(map(fits, threads))
    return lambda threads: all(map(fits, threads))


def _told(asked: Requested) -> str:
    return _words(asked.policy, asked.priority, asked.cpus)


def _seen(threads: Iterable[State]) -> str:
    found = dict.fromkeys(_words(policy, priority, sorted(cpus)) for policy, priority, cpus in threads)
    return "; ".join(list(found)[:4]) or "nothing"


def _words(policy: str | None, priority: int | None, cpus: list[int] | None) -> str:
    on = f" on CPUs {','.join(map(str, cpus))}" if cpus is not None else ""
    return f"{policy or 'any policy'} {priority if priority is not None else ''}".rstrip() + on
