"""The command line of cyclictest, as its JSON records it; its options are read as getopt_long(3) reads them.

rt-tests joins the words with blanks and quotes nothing. The options are those of rt-tests 1.9, the first version with
JSON, to 2.10.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rtfiles.errors import UsageError
from rtrun.kinds.limits import CPU_DMA_LATENCY_MAX_US, RT_PRIORITY_MAX
from rtrun.plan.quantities import INTERVAL_MAX_US
from rtrun.plan.suites import Value
from rtrun.results.importers.counts import words_in

COMMAND_MAX = 4096  #: characters of the command line in an imported file, where rt-tests cuts it off
OPTIONS_MAX = 256  #: characters of the options that tell imported runs apart, beside our parameters
_MOST_BINS = 1_000_000  # cyclictest takes larger numbers as this one; it is not our limit

_Takes = Literal["nothing", "value", "maybe"]


@dataclass(frozen=True, slots=True)
class _Option:
    """An option of cyclictest: its letter, whether it takes a value, and whether it is `telling`.

    A telling option changes the measurement but is not one of our parameters. Threads and their CPUs are never telling:
    the file itself states them.
    """

    name: str
    letter: str
    takes: _Takes
    telling: bool = False


_OPTIONS = (
    _Option("affinity", "a", "maybe"),
    _Option("aligned", "A", "maybe", telling=True),
    _Option("breaktrace", "b", "value", telling=True),
    _Option("clock", "c", "value", telling=True),
    _Option("dbg_cyclictest", "", "nothing"),
    _Option("deepest-idle-state", "", "value", telling=True),
    _Option("default-system", "", "nothing", telling=True),
    _Option("distance", "d", "value"),  # 0 with a histogram, whatever was asked for
    _Option("duration", "D", "value"),
    _Option("fifo", "F", "value"),
    _Option("help", "", "nothing"),
    _Option("histfile", "", "value"),
    _Option("histofall", "H", "value"),
    _Option("histogram", "h", "value"),
    _Option("interval", "i", "value"),
    _Option("json", "", "value"),
    _Option("laptop", "", "nothing", telling=True),
    _Option("latency", "", "value"),
    _Option("loops", "l", "value"),
    _Option("mainaffinity", "", "value", telling=True),
    _Option("mlockall", "m", "nothing", telling=True),
    _Option("nsecs", "N", "nothing"),
    _Option("oscope", "o", "value"),
    _Option("output", "", "value"),  # --json of 1.9
    _Option("policy", "", "value"),
    _Option("posix_timers", "x", "nothing", telling=True),
    _Option("priority", "p", "value"),
    _Option("priospread", "", "nothing", telling=True),
    _Option("quiet", "q", "nothing"),
    _Option("refresh_on_max", "M", "nothing"),
    _Option("relative", "r", "nothing", telling=True),
    _Option("resolution", "R", "nothing"),
    _Option("secaligned", "", "maybe", telling=True),
    _Option("smi", "", "nothing", telling=True),
    _Option("smp", "S", "nothing"),
    _Option("spike", "", "value", telling=True),
    _Option("spike-nodes", "", "value", telling=True),
    _Option("system", "s", "nothing", telling=True),
    _Option("threads", "t", "maybe"),
    _Option("tracemark", "", "nothing", telling=True),
    _Option("unbuffered", "u", "nothing"),
    _Option("verbose", "v", "nothing"),
)
_BY_NAME = {option.name: option for option in _OPTIONS}
_BY_LETTER = {option.letter: option for option in _OPTIONS if option.letter}
# Matches the next word if it is the value of an option whose value is optional.
_VALUES = {"affinity": re.compile(r"[0-9!+a].*")}
_NUMBER = re.compile(r"[+-]?0*[1-9].*")
# As cyclictest compares them; any other word is SCHED_OTHER.
_POLICIES = {"batch": "BATCH", "idle": "IDLE", "fifo": "FIFO", "rr": "RR"}
# With any of these, nothing keeps idle CPUs awake.
_SLEEPING = ("laptop", "default-system", "deepest-idle-state")


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """What a command line of cyclictest asks for; `limit` is one more than the last bin, None without a histogram."""

    limit: int | None = None
    interval_us: int = 1000
    nanoseconds: bool = False
    policy: str = "0"
    priority: int = 0
    cpu_dma_latency_us: int | None = 0
    options: str = ""
    """What else changes the measurement: long names, sorted, and every word that no version knows."""

    def parameters(self, threads: int) -> dict[str, Value]:
        """The parameters of a run of `threads` threads; cyclictest derives a priority from them where none is given."""
        parameters: dict[str, Value] = {
            "policy": self.policy,
            "interval_us": self.interval_us,
            "threads": threads,
            "cpu_dma_latency_us": self.cpu_dma_latency_us,
        }
        if self.policy in ("FIFO", "RR"):
            parameters["priority"] = self.priority or min(threads + 1, RT_PRIORITY_MAX)
        return parameters | ({"options": self.options} if self.options else {})


def read_command(path: Path, where: str, text: object) -> Command:
    """Read a command line; of an option that is given twice, the last one counts.

    Raises UsageError ``file: where: what is wrong``.
    """
    line = words_in(path, where, text, most=COMMAND_MAX)
    if line.endswith(" "):
        raise UsageError(f"{path}: {where}: cut off: what else was asked for is not known")
    given: dict[str, str] = {}
    unknown = []
    for name, value in _parse(line.split()[1:]):
        if name is None:
            unknown.append(value)
        else:
            given.pop(name, None)  # keep the order of the last occurrences
            given[name] = value
    telling = [f"--{name}{value and '='}{value}" for name, value in sorted(given.items()) if _BY_NAME[name].telling]
    options = " ".join([*telling, *unknown])
    if len(options) > OPTIONS_MAX:
        raise UsageError(f"{path}: {where}: more than {OPTIONS_MAX} characters of options that change a measurement")
    bins = _number(path, where, given, "histogram", 0, highest=10**9)
    return Command(
        limit=min(bins, _MOST_BINS) or None,
        interval_us=_number(path, where, given, "interval", 1000, lowest=1, highest=INTERVAL_MAX_US),
        nanoseconds="nsecs" in given,
        policy=_policy(given),
        priority=_number(path, where, given, "priority", 0, highest=RT_PRIORITY_MAX),
        cpu_dma_latency_us=(
            None
            if any(name in given for name in _SLEEPING)
            else _number(path, where, given, "latency", 0, highest=CPU_DMA_LATENCY_MAX_US)
        ),
        options=options,
    )


def _parse(words: Sequence[str]) -> Iterator[tuple[str | None, str]]:
    """Yield the long name of each option with its value, "" without one; an unknown word has None for a name."""
    rest = [*words]
    while rest:
        word = rest.pop(0)
        if word.startswith("--"):
            name, _, value = word[2:].partition("=")
            option = _by_prefix(name)
            if option is None:
                yield None, word
                continue
            yield _named(option), value or _next(option, rest)
        elif word.startswith("-") and len(word) > 1:
            yield from _short(word, rest)
        else:
            yield None, word


def _short(word: str, rest: list[str]) -> Iterator[tuple[str | None, str]]:
    """Yield the options in a word like ``-qh400``."""
    for place, letter in enumerate(word[1:], start=2):
        option = _BY_LETTER.get(letter)
        if option is None:
            yield None, f"-{word[place - 1 :]}"
            return
        if option.takes != "nothing":
            yield _named(option), word[place:] or _next(option, rest)
            return
        yield _named(option), ""


def _next(option: _Option, rest: list[str]) -> str:
    """Take the next word if it is the value of this option."""
    form = _VALUES.get(option.name, _NUMBER)
    if rest and (option.takes == "value" or (option.takes == "maybe" and form.fullmatch(rest[0]))):
        return rest.pop(0)
    return ""


def _by_prefix(name: str) -> _Option | None:
    """The option of this name, or the only option that begins with it."""
    starting = [option for option in _OPTIONS if option.name.startswith(name)]
    return _BY_NAME.get(name) or (starting[0] if len(starting) == 1 else None)


def _named(option: _Option) -> str:
    return "histogram" if option.name == "histofall" else option.name


def _policy(given: dict[str, str]) -> str:
    """The policy in effect: a priority makes it FIFO, even priority 0 unless a policy follows it."""
    asked = given.get("policy", "").lower()
    policy = next((name for start, name in _POLICIES.items() if asked.startswith(start)), "0")
    last = next((name for name in reversed(given) if name in ("policy", "priority")), "")
    real_time = _atoi(given.get("priority", "")) > 0 or last == "priority" or "priospread" in given
    return "FIFO" if real_time and policy not in ("FIFO", "RR") else policy


def _number(
    path: Path, where: str, given: Mapping[str, str], name: str, default: int, *, lowest: int = 0, highest: int
) -> int:
    value = _atoi(given[name]) if name in given else default
    if not lowest <= value <= highest:
        raise UsageError(
            f"{path}: {where}: --{name} {given[name][:40]!r}: expected a whole number from {lowest} to {highest}"
        )
    return value


def _atoi(word: str) -> int:
    """The number at the begin of a word, as C reads it; 0 without one."""
    match = re.match(r"[+-]?[0-9]{1,18}", word, re.ASCII)
    return int(match[0]) if match else 0
