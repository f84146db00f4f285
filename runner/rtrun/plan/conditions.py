"""Conditions: the background programs of a run and the settings of its target, read from conditions.yml."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from rtfiles.config import Config, load_own
from rtfiles.errors import UsageError
from rtfiles.untrusted import whole_number
from rtfiles.wording import unknown
from rtrun.kinds.limits import CPUS_MAX
from rtrun.plan.middleware.description import NONE
from rtrun.plan.program import Program
from rtrun.plan.suites import Option, Strings, Value, check_numbers

FILE = Path(__file__).with_name("conditions.yml")
IDLE = "idle"
# Loads may run this much longer than the suite's deadline, so that the runner ends them and not their own deadline.
OUTLIVE_S = 300.0
# The nodes of a condition send for this multiple of the suite's expected time, plus time for a slow start.
MESSAGES_FACTOR = 2
MESSAGES_EXTRA_S = 120.0
# Time for loads to start their workers and allocate memory before the suite starts.
SETTLE_S = 1.0
# The sampler makes its first observation this long after its start, which comes just before that of the suite.
FIRST_OBSERVATION_S = 1.0
# The setting that switches off the sampler.
SAMPLER = "sampler"
# Parameters and settings that are lists of CPUs.
CPU_LISTS = ("cpu", "load_cpu", "irq_cpu")


class Load(Config):
    """A program that runs in the background of the suite."""

    argv: Strings
    workers: str = "0"
    """The number of processes that it must always have, not counting itself."""
    repeated: str | None = None
    """The setting that gives the number of its instances; None: one instance."""


class Condition(Config):
    """A condition that a campaign names: its loads, by name, and the settings they take."""

    summary: str
    loads: dict[str, Load] = Field(default_factory=dict)
    takes: Strings = ()
    middleware: str = NONE
    """The middleware of its loads, if they are programs of the suites."""
    busy_percent: int = 0
    """The least share of all CPUs' time that must be busy, in percent; only for loads that may use all CPUs."""


class Conditions(Config):
    """The whole of conditions.yml."""

    schema_number: Literal[1] = Field(alias="schema")
    settings: dict[str, Option]
    pinned: dict[str, Strings]
    """The program that sets each such setting and keeps it."""
    conditions: dict[str, Condition]


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """A background program, and how many processes it must have, itself included."""

    program: Program
    processes: int
    is_load: bool
    """Whether it is a load of the condition; otherwise it keeps a setting in effect."""


def _check_settings(values: dict[str, Value]) -> dict[str, Value]:
    return check_numbers(values, conditions().settings)


Settings = Annotated[dict[str, Value], AfterValidator(_check_settings)]
"""Settings of a run, by key."""


@functools.cache
def conditions() -> Conditions:
    """The conditions of this version, read once."""
    return load_own(FILE, Conditions)


def condition(name: object, where: str) -> Condition:
    """The condition of this name. Raises UsageError ``where: …`` that lists the known ones."""
    known = conditions().conditions
    if not isinstance(name, str) or name not in known:
        raise UsageError(f"{where}: {unknown('condition', name, known=known)}")
    return known[name]


def settings_of(name: str) -> tuple[str, ...]:
    """The settings that a condition takes; those that every condition takes come last."""
    return (*conditions().conditions[name].takes, *conditions().pinned, SAMPLER)


def check(key: str, value: object, where: str) -> Value:
    """Return a setting's value. Raises UsageError ``where: key takes …, got …``."""
    try:
        accepted = conditions().settings[key].accept(value)
    except ValueError as error:
        raise UsageError(f"{where}: {key} {error}") from None
    check_cpus(key, accepted, where)
    return accepted


def needs(name: str, settings: Mapping[str, Value]) -> set[str]:
    """What the target must have for a condition, as missing.sh takes it: tools, and settings as ``key=value``."""
    loads = conditions().conditions[name].loads.values()
    tools = {load.argv[0] for load in loads if not load.argv[0].startswith("{")}
    tools |= {"taskset"} if loads and settings.get("load_cpu") else set()
    return tools | {f"{key}={settings[key]}" for key in conditions().pinned if settings.get(key)}


def middleware_of_loads(name: str) -> str:
    """The middleware of the suites' own programs that a condition starts."""
    return conditions().conditions[name].middleware


def suites_programs(name: str) -> set[str]:
    """The suites' own executables that a condition starts."""
    loads = conditions().conditions[name].loads.values()
    return {load.argv[0].strip("{}") for load in loads if load.argv[0].startswith("{")}


def background(
    name: str,
    settings: Mapping[str, Value],
    *,
    cpus: int,
    programs: Mapping[str, str],
    scripts: PurePosixPath,
    environment: tuple[tuple[str, str], ...],
    expected_s: float,
    deadline_s: float,
) -> list[Background]:
    """The programs that run in the background under a condition, in the order of their start.

    `cpus` is the number of CPUs of the target, `programs` are the paths of the suites' executables there, `expected_s`
    and `deadline_s` are the times of the suite.
    """
    load_cpus = str(settings.get("load_cpu") or "")
    lifetime_s = deadline_s + OUTLIVE_S
    words = {key: value for key, value in settings.items() if value is not None} | dict(programs)
    words |= {
        "scripts": str(scripts),
        "cpus": len(cpu_set(load_cpus)) if load_cpus else cpus,
        "lifetime_s": math.ceil(lifetime_s),
        "messages": round(int(settings.get("nodes_hz") or 1) * (MESSAGES_FACTOR * expected_s + MESSAGES_EXTRA_S)),
    }

    def planned(
        program: str, argv: Strings, *, number: int = 0, workers: str = "0", is_load: bool = False
    ) -> Background:
        given = ("taskset", "-c", load_cpus, *argv) if is_load and load_cpus else argv
        filled = [word.format_map(words | {"name": program, "number": number}) for word in given]
        return Background(
            program=Program(name=program, argv=tuple(filled), environment=environment, deadline_s=lifetime_s),
            processes=1 + int(workers.format_map(words)),
            is_load=is_load,
        )

    started = [planned(f"hold-{key}", argv) for key, argv in conditions().pinned.items() if settings.get(key)]
    for program, described in conditions().conditions[name].loads.items():
        numbers = range(int(settings[described.repeated] or 0)) if described.repeated else [None]
        started += [
            planned(
                program if number is None else f"{program}{number}",
                described.argv,
                number=number or 0,
                workers=described.workers,
                is_load=True,
            )
            for number in numbers
        ]
    return started


def cpu_set(text: str) -> set[int]:
    """The CPUs in a list as the kernel writes it, ``0-1,4``. Raises ValueError."""
    cpus: set[int] = set()
    listed = 0
    for part in text.split(","):
        first, dash, last = part.partition("-")
        low = whole_number(first, lowest=0, highest=CPUS_MAX - 1)
        high = whole_number(last, lowest=low, highest=CPUS_MAX - 1) if dash else low
        listed += high + 1 - low
        if listed > CPUS_MAX:
            raise ValueError(f"a list of more than {CPUS_MAX} CPUs")
        cpus |= set(range(low, high + 1))
    return cpus


def check_cpus(key: str, value: Value, where: str) -> None:
    """Check a parameter or setting that is a list of CPUs; empty is fine. Raises UsageError."""
    if key in CPU_LISTS and value:
        try:
            cpu_set(str(value))
        except ValueError as error:
            raise UsageError(f"{where}: {key} takes a list of CPUs like 0-1,4, got {value!r}: {error}") from None


def must_be_observed(name: str, settings: Mapping[str, Value]) -> bool:
    """Whether a run under this condition counts only if the sampler has observed the condition while it measured."""
    return bool(conditions().conditions[name].loads) or any(settings.get(key) for key in conditions().pinned)


def settle_s(name: str, settings: Mapping[str, Value]) -> float:
    """How long background programs are waited for before the suite starts, in seconds."""
    return SETTLE_S if must_be_observed(name, settings) else 0.0
