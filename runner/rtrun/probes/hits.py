"""The types for what the probes saw: they pass from the reader of a target's trace to the readers of messages and
timers."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePosixPath
from typing import NamedTuple

_INTERPRETER = re.compile(r"python[0-9.]*")
GAPS_MAX = 10_000  #: gaps of one cause of an observation; beyond that, those that lie close together become one

HITS_CLOCK, SYSTEM, RAW = "steady", "system", "raw"
"""The clock of the hits, CLOCK_MONOTONIC; CLOCK_REALTIME and CLOCK_MONOTONIC_RAW, whose offsets have to be read."""


class ClockReading(NamedTuple):
    """Another clock was `offset_ns` ahead of the hits' clock when the hits' clock showed `at_ns`."""

    clock: str
    at_ns: int
    offset_ns: int


class Hit(NamedTuple):
    """A probed function was called.

    `at_ns` is of CLOCK_MONOTONIC. `pid` is 0 if the process of the thread is not known. `event` is its name in the
    probes' data; `values` are the arguments, by their names there.
    """

    at_ns: int
    cpu: int
    pid: int
    tid: int
    event: str
    values: Mapping[str, int | str]


class GapCause(StrEnum):
    """Why hits are missing."""

    RESTED = "rested"
    """There were more events than the limit."""
    EVENTS_LOST = "events lost"
    """The kernel lost them, or gave them out of order."""
    LINK_LOST = "link lost"
    WATCHDOG_SILENT = "watchdog silent"
    """The process that reads the probes on the target was stopped or killed, while the link was there."""
    ENDED_EARLY = "ended early"
    """The observation was over before the time that was asked for."""


class Gap(NamedTuple):
    """A time in which hits are missing: the kernel lost events, or the probes paused because there were too many.

    `from_ns` and `until_ns` are of CLOCK_MONOTONIC. What was seen before a gap must not be joined with what came after.
    """

    from_ns: int
    until_ns: int
    reason: str
    cause: GapCause


def covered_ns(spans: Iterable[tuple[int, int]]) -> int:
    """The time in ns that at least one of these spans (begin, end) covers; they may overlap, as the gaps of two CPUs
    do."""
    covered = until_ns = 0
    for begin_ns, end_ns in sorted(spans):
        covered += max(0, end_ns - max(begin_ns, until_ns))
        until_ns = max(until_ns, end_ns)
    return covered


def joined(gaps: Iterable[Gap]) -> list[Gap]:
    """Sort gaps by their begin, and join overlapping gaps of the same cause; each cause keeps at most GAPS_MAX.

    Beyond that, gaps with the shortest time between them are joined, too: that time then counts as not seen.
    """
    by_cause: dict[GapCause, list[Gap]] = {}
    for gap in sorted(gaps):
        _add(by_cause.setdefault(gap.cause, []), gap)
    return sorted(gap for of_cause in by_cause.values() for gap in _fewer(of_cause))


def _add(gaps: list[Gap], gap: Gap) -> None:
    """Add a gap that begins no earlier than those before."""
    if gaps and gap.from_ns <= gaps[-1].until_ns:
        last = gaps.pop()
        gap = last._replace(until_ns=max(gap.until_ns, last.until_ns))
    gaps.append(gap)


def _fewer(gaps: list[Gap]) -> list[Gap]:
    if len(gaps) <= GAPS_MAX:
        return gaps
    between = sorted(range(1, len(gaps)), key=lambda place: gaps[place].from_ns - gaps[place - 1].until_ns)
    given_up = set(between[: len(gaps) - GAPS_MAX])
    fewer: list[Gap] = []
    for place, gap in enumerate(gaps):
        fewer.append(fewer.pop()._replace(until_ns=gap.until_ns) if place in given_up else gap)
    return fewer


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramThread:
    """A thread of an observed program, as the kernel shows it."""

    tid: int
    name: str
    policy: str
    priority: int
    cpus: tuple[int, ...]

    @property
    def is_real_time(self) -> bool:
        return self.policy in ("FIFO", "RR", "DEADLINE")


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservedProgram:
    """A process that maps a library with probes, or whose loops are observed.

    `start_ticks` distinguishes it from a later process of the same pid. `file` is the name of the file that it runs,
    without the folder. `locked_bytes` is its locked memory (VmLck). `libraries` are the target's paths of the libraries
    with probes that it maps.
    """

    pid: int
    start_ticks: int
    name: str
    argv: tuple[str, ...]
    locked_bytes: int
    libraries: tuple[str, ...]
    threads: tuple[ProgramThread, ...]
    file: str = ""

    @property
    def file_name(self) -> str:
        """The name of its file; of a script for an interpreter, that of the script."""
        if _INTERPRETER.fullmatch(self.file):
            return script_of((self.file, *self.argv[1:])) or self.file
        return self.file or self.name


def script_of(argv: Sequence[str]) -> str:
    """The name of a program by its command line: of a script for an interpreter, that of the script."""
    if not argv:
        return ""
    name = PurePosixPath(argv[0]).name
    if not _INTERPRETER.fullmatch(name):
        return name
    words = list(argv[1:])
    if "-m" in words[:-1]:
        return words[words.index("-m") + 1]
    return next((PurePosixPath(word).name for word in words if not word.startswith("-")), name)
