"""What the sampler saw on the target while a run measured, read into types.

All of it comes from the target: text that neither sample.sh nor rt_tests_sampler writes is a UsageError.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TextIO

from rtfiles.errors import UsageError
from rtfiles.untrusted import LINE_CHARACTERS_MAX, MIB, real_number, whole_number
from rtrun.kinds.limits import (
    FREQUENCY_MAX_KHZ,
    PID_MAX,
    RT_PRIORITY_MAX,
    RT_RUNTIME_MAX_US,
    TEMPERATURE_MAX_MC,
    UPTIME_MAX_S,
    NumberT,
    Range,
)
from rtrun.plan.conditions import cpu_set
from rtrun.results.output import NON_MEASURING_THREADS
from rtrun.results.record import Observed, Rival
from rtrun.targets.inspection.facts import POLICIES

SAMPLER = "sampler"
SAMPLER_OUTPUT = f"{SAMPLER}.stdout"
# The exit status of the sampler where the disk of the target is full: the number of ENOSPC.
DISK_FULL = "28"
REPORTED_RIVALS = 32
# The time between two observations.
APART_S = 2.0
# The observations of a month. The text of a sampler is limited as well.
OBSERVATIONS_MAX = 1_500_000  #: observations of the sampler
# The bytes of an observation on average, and what all may have on top; on small boards one has 200 to 1000.
OBSERVATION_BYTES = 4096  #: what the sampler of a run printed in two seconds, on average, as copied
OUTPUT_BYTES = 8 * MIB  #: more than that of a whole run
# The lines of the state at one moment: one for each real-time thread and each load, and a few more.
STATE_LINES_MAX = 50_000  #: lines of one state that the sampler prints
# CPUs in all the different sets that threads and loads may run on: enough for a month on a machine with hundreds.
SETS_CPUS_MAX = 250_000  #: CPUs in all different sets that the sampler saw
RIVALS_MAX = 10_000  #: different rivals of a run that the sampler saw; more are left out
# Names in a line of counts: enough for a PC with many devices.
COUNTS_MAX = 512  #: counts of an observation of the sampler
# A line of the state is split at most so often: it may end with a name that has blanks.
_SPLIT_WORDS = 24
_COUNTS = re.compile(r"counts( [A-Za-z0-9_.:-]{1,64}=\d{1,15})*", re.ASCII)

ThreadState = tuple[str, int, frozenset[int]]
"""Policy, priority and CPUs of a thread."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What was in effect at one moment; `threads` by program, `loads` by program: processes and CPUs."""

    uptime_s: float
    until_s: float
    """When all of it had been read."""
    load_1min: float
    temperature_mc: tuple[int, ...]
    frequency_khz: tuple[int, ...]
    ticks_by_kind: tuple[int, ...]
    """Ticks of all CPUs since the boot: user, nice, system, idle, iowait, irq, softirq, steal (proc(5))."""
    counts: str = ""
    """What was counted since the previous observation, as ``name=number name=number``."""
    threads: Mapping[str, tuple[ThreadState, ...]] = field(default_factory=dict)
    loads: Mapping[str, tuple[int, frozenset[int]]] = field(default_factory=dict)
    rivals: frozenset[Rival] = frozenset()
    governor: tuple[str, ...] = ()
    sched_rt_runtime_us: int | None = None

    @property
    def ticks(self) -> int:
        """All ticks of all CPUs since the boot."""
        return sum(self.ticks_by_kind)

    @property
    def busy(self) -> int:
        """The ticks that were not idle."""
        return self.ticks - sum(self.ticks_by_kind[3:5])


def read_text(path: Path) -> str:
    """What a program printed; nothing where there is no such file."""
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def output_bytes_max(lifetime_s: float) -> int:
    """The largest plausible output, in bytes, of a sampler that runs for this long."""
    return OUTPUT_BYTES + math.ceil(lifetime_s / APART_S) * OBSERVATION_BYTES


def observations_of(folder: Path) -> list[Observation]:
    """The observations of the run in a folder; none where it was not observed. Raises UsageError."""
    path = folder / SAMPLER_OUTPUT
    if not path.exists():
        return []
    with path.open(encoding="utf-8", errors="replace", newline="\n") as stream:
        return read_observations(stream)


def _whole_lines(stream: TextIO) -> Iterator[str]:
    """Yield the lines of a text that may be large, without a last line that is cut off. Raises UsageError."""
    number = 0
    while (line := stream.readline(LINE_CHARACTERS_MAX + 1)).endswith("\n"):
        number += 1
        yield line[:-1]
    if len(line) > LINE_CHARACTERS_MAX:
        raise UsageError(f"{SAMPLER_OUTPUT}:{number + 1}: a line of more than {LINE_CHARACTERS_MAX} characters")


def read_observations(stream: TextIO) -> list[Observation]:
    """Read what a sampler printed, as far as it goes: a last line that was cut off is left out. Raises UsageError."""
    observations: list[Observation] = []
    block: list[str] = []
    known = _Known()
    for number, line in enumerate(_whole_lines(stream), start=1):
        words = line.split(maxsplit=COUNTS_MAX)
        try:
            if words[:1] == ["at"]:
                if len(observations) == OBSERVATIONS_MAX:
                    raise ValueError
                observations.append(_begin(words, observations[-1] if observations else None))
                block = []
            elif words[:1] == ["counts"]:
                if not _COUNTS.fullmatch(line) or len(words) > COUNTS_MAX:
                    raise ValueError
                observations[-1] = replace(observations[-1], counts=line[len("counts ") :])
            elif words[:1] == ["end"]:
                observations[-1] = _complete(observations[-1], block, words[1:], known)
            else:
                if len(block) == STATE_LINES_MAX:
                    raise ValueError
                block.append(line)
        except (ValueError, IndexError, KeyError):
            raise UsageError(f"{SAMPLER_OUTPUT}:{number}: not what sample.sh writes: {line[:80]!r}") from None
    return observations


class _Known:
    """The sets of CPUs and the rivals of all observations: equal ones are kept once."""

    def __init__(self) -> None:
        self._sets: dict[str, frozenset[int]] = {"-": frozenset()}
        self._cpus = 0
        self._rivals: dict[Rival, Rival] = {}

    def cpus(self, word: str) -> frozenset[int]:
        """The set of CPUs of a list. Raises ValueError for a text that is no list, and for too many CPUs."""
        if word not in self._sets:
            cpus = self._sets[word] = frozenset(cpu_set(word))
            self._cpus += len(cpus) + len(word)
            if self._cpus > SETS_CPUS_MAX:
                raise ValueError
        return self._sets[word]

    def rival(self, rival: Rival) -> Rival | None:
        """The known rival that equals this one; None where there is no room for another one."""
        if rival not in self._rivals and len(self._rivals) >= RIVALS_MAX:
            return None
        return self._rivals.setdefault(rival, rival)


def _begin(words: list[str], before: Observation | None) -> Observation:
    # User and nice include the guest times that follow.
    ticks = tuple(whole_number(word, lowest=0) for word in words[6:14])
    if len(ticks) < 8:
        raise ValueError
    uptime_s = _uptime_s(words[1])
    gauges: dict[str, Any] = {
        "uptime_s": uptime_s,
        "until_s": uptime_s,
        "load_1min": real_number(words[2], lowest=0, highest=PID_MAX),
        "temperature_mc": _readings(words[3], -TEMPERATURE_MAX_MC, TEMPERATURE_MAX_MC),
        "frequency_khz": _readings(words[4], 0, FREQUENCY_MAX_KHZ),
        "ticks_by_kind": ticks,
        "counts": "",
    }
    return replace(before, **gauges) if before else Observation(**gauges)


def _complete(observation: Observation, block: list[str], until: list[str], known: _Known) -> Observation:
    threads: dict[str, list[ThreadState]] = {}
    loads: dict[str, tuple[int, frozenset[int]]] = {}
    rivals: set[Rival] = set()
    governor: tuple[str, ...] = ()
    runtime_us: int | None = None
    for line in block:
        words = line.split(maxsplit=_SPLIT_WORDS)
        if words[0] == "thread":
            if " ".join(words[6:]) in NON_MEASURING_THREADS:
                continue
            state = (_policy(words[3]), _priority(words[4]), known.cpus(words[5]))
            threads.setdefault(words[1], []).append(state)
        elif words[0] == "load":
            loads[words[1]] = (whole_number(words[2], lowest=0, highest=PID_MAX), known.cpus(words[3]))
        elif words[0] == "rival":
            if rival := known.rival(_rival(words)):
                rivals.add(rival)
        elif words[0] == "governor":
            governor = () if words[1] == "-" else tuple(dict.fromkeys(words[1].split(",")))
        elif words[0] == "sched_rt_runtime_us":
            runtime_us = None if words[1] == "-" else whole_number(words[1], lowest=-1, highest=RT_RUNTIME_MAX_US)
    # Runs that were measured before 2026-11-23 do not have it.
    until_s = _uptime_s(until[0]) if until else observation.uptime_s
    return replace(
        observation,
        until_s=until_s,
        threads={name: tuple(states) for name, states in threads.items()},
        loads=loads,
        rivals=frozenset(rivals),
        governor=governor,
        sched_rt_runtime_us=runtime_us,
    )


def _rival(words: list[str]) -> Rival:
    name, policy = " ".join(words[4:]), _policy(words[2])
    if policy != "DEADLINE":
        return Rival(name=name, policy=policy, priority=whole_number(words[3]))
    if words[3] == "-":
        return Rival(name=name, policy=policy, priority=0)
    runtime_ns, period_ns = (whole_number(word, lowest=0) for word in words[3].split("/"))
    return Rival(name=name, policy=policy, priority=0, runtime_ns=runtime_ns, period_ns=period_ns)


def _policy(word: str) -> str:
    return POLICIES[whole_number(word)]


def _priority(word: str) -> int:
    return whole_number(word, lowest=0, highest=RT_PRIORITY_MAX)


def _uptime_s(word: str) -> float:
    return real_number(word, lowest=0, highest=UPTIME_MAX_S)


def _readings(word: str, lowest: int, highest: int) -> tuple[int, ...]:
    """The lowest and the highest reading of the sensors, without broken ones."""
    numbers = [] if word == "-" else [whole_number(number) for number in word.split(",")]
    known = [number for number in numbers if lowest <= number <= highest]
    return tuple(sorted({min(known), max(known)})) if known else ()


def while_measuring(observations: Iterable[Observation], *, is_attached: bool = False) -> list[Observation]:
    """The observations in which the suite had a thread; all of them for a run that observes other programs."""
    return [sample for sample in observations if sample.threads or is_attached]


def busy_percent(observations: Sequence[Observation]) -> float | None:
    """Share of all CPUs' time that was not idle between the first and the last observation, in percent."""
    ticks = observations[-1].ticks - observations[0].ticks if observations else 0
    if ticks <= 0:
        return None
    # The time of waiting for disks may go back (proc(5)).
    return round(min(max(0.0, 100 * (observations[-1].busy - observations[0].busy) / ticks), 100.0), 1)


def summarize(
    observations: Iterable[Observation], states: Iterable[ThreadState], *, is_attached: bool = False
) -> Observed:
    """The part for run.json: every value seen while the suite measured, and the fewest processes of each load.

    `states` are those of the measuring threads. A run that observes other programs has no rivals: the observed programs
    would be among them.
    """
    seen, states = while_measuring(observations, is_attached=is_attached), list(states)
    names = sorted({name for sample in seen for name in sample.loads})
    rivals = {rival for sample in seen for rival in sample.rivals if not is_attached}
    first = sorted(rivals, key=lambda rival: (rival.policy != "DEADLINE", -rival.priority, rival.name))
    return Observed(
        policy=sorted({policy for policy, _, _ in states}),
        priority=sorted({priority for _, priority, _ in states}),
        cpus=_union(cpus for _, _, cpus in states),
        loads={name: min(sample.loads[name][0] if name in sample.loads else 0 for sample in seen) for name in names},
        load_cpus=_union(cpus for sample in seen for _, cpus in sample.loads.values()),
        governor=sorted({name for sample in seen for name in sample.governor}),
        busy_percent=busy_percent(seen),
        sched_rt_runtime_us=sorted({sample.sched_rt_runtime_us for sample in seen if sample.sched_rt_runtime_us}),
        temperature_mc=_range(value for sample in seen for value in sample.temperature_mc),
        frequency_khz=_range(value for sample in seen for value in sample.frequency_khz),
        load_1min=_range(sample.load_1min for sample in seen),
        rivals=first[:REPORTED_RIVALS],
        observations=len(seen),
    )


def _union(sets: Iterable[frozenset[int]]) -> list[int]:
    """The union of many sets, most of which are equal."""
    return sorted(frozenset[int]().union(*set(sets)))


def _range(values: Iterable[NumberT]) -> Range[NumberT] | None:
    known = list(values)
    return [min(known), max(known)] if known else None
