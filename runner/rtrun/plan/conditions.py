"""What happens on a target beside the suite: conditions.yml read into types, and the programs that make it so."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, load
from rtfiles.errors import UsageError
from rtrun.plan.program import Program
from rtrun.plan.suites import Option, Strings, Value

FILE = Path(__file__).with_name("conditions.yml")
IDLE = "idle"
# Loads outlive the suite's deadline, so that they end with the run and never before.
OUTLIVE_S = 300.0
# Nodes send this much longer than the suite should measure, and then some for a slow start.
MESSAGES_FACTOR = 2
MESSAGES_EXTRA_S = 120.0


class Load(Config):
    """A program that runs beside the suite."""

    argv: Strings
    workers: str = "0"
    """Processes that it must have beside itself all the time."""
    repeated: str | None = None
    """The setting that says how many of it there are; none: one."""


class Condition(Config):
    """What a campaign names: its loads, by name, and the settings they take."""

    summary: str
    loads: dict[str, Load] = Field(default_factory=dict)
    takes: Strings = ()
    busy_percent: int = 0
    """Share of all CPUs' time that is not idle while it lasts, at least; for a load that may run on all of them."""


class Conditions(Config):
    """The whole of conditions.yml."""

    schema_number: Literal[1] = Field(alias="schema")
    settings: dict[str, Option]
    holds: dict[str, Strings]
    conditions: dict[str, Condition]


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """A program beside the suite, and how many processes it must have, itself included."""

    program: Program
    processes: int


@functools.cache
def conditions() -> Conditions:
    """The conditions of this version, read once."""
    return load(FILE, Conditions)


def condition(name: object, where: str) -> Condition:
    """The condition of this name. Raises UsageError ``where: …`` that lists the known ones."""
    known = conditions().conditions
    if not isinstance(name, str) or name not in known:
        raise UsageError(f"{where}: unknown condition {name!r}, known: {', '.join(known)}")
    return known[name]


def settings_of(name: str) -> tuple[str, ...]:
    """The settings that a condition takes; what every condition takes stands last."""
    return (*conditions().conditions[name].takes, *conditions().holds)


def check(key: str, value: object, where: str) -> Value:
    """Return a setting's value. Raises UsageError ``where: key takes …, got …``."""
    try:
        return conditions().settings[key].accept(value)
    except ValueError as error:
        raise UsageError(f"{where}: {key} {error}") from None


def needs(name: str, settings: Mapping[str, Value]) -> set[str]:
    """What the target must have for a condition, as missing.sh takes it: tools, and settings as ``key=value``."""
    loads = conditions().conditions[name].loads.values()
    found = {each.argv[0] for each in loads if not each.argv[0].startswith("{")}
    found |= {"taskset"} if loads and settings.get("load_cpu") else set()
    return found | {f"{key}={settings[key]}" for key in conditions().holds if settings.get(key)}


def suites_programs(name: str) -> set[str]:
    """The suites' own executables that a condition starts."""
    loads = conditions().conditions[name].loads.values()
    return {each.argv[0].strip("{}") for each in loads if each.argv[0].startswith("{")}


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
    """The programs that make a condition so, in the order of their start.

    `cpus` are those of the target, `programs` the paths of the suites' executables there, `expected_s` and `deadline_s`
    those of the suite.
    """
    pinned = str(settings.get("load_cpu") or "")
    words = {key: value for key, value in settings.items() if value is not None} | dict(programs)
    words |= {
        "scripts": str(scripts),
        "cpus": len(cpu_set(pinned)) if pinned else cpus,
        "messages": round(int(settings.get("nodes_hz") or 1) * (MESSAGES_FACTOR * expected_s + MESSAGES_EXTRA_S)),
    }
    found: list[Background] = []

    def add(program: str, argv: Strings, number: int, processes: str) -> None:
        filled = [word.format_map(words | {"name": program, "number": number}) for word in argv]
        found.append(
            Background(
                program=Program(
                    name=program,
                    argv=tuple(filled),
                    environment=environment,
                    deadline_s=deadline_s + OUTLIVE_S,
                ),
                processes=1 + int(processes.format_map(words)),
            )
        )

    for key, argv in conditions().holds.items():
        if settings.get(key):
            add(f"hold-{key}", argv, 0, "0")
    for program, each in conditions().conditions[name].loads.items():
        argv = ("taskset", "-c", pinned, *each.argv) if pinned else each.argv
        for number in range(int(settings[each.repeated] or 0) if each.repeated else 1):
            add(f"{program}{number}" if each.repeated else program, argv, number, each.workers)
    return found


def cpu_set(text: str) -> set[int]:
    """The CPUs in a list as the kernel writes it, ``0-1,4``. Raises ValueError."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        found |= set(range(int(first), int(last or first) + 1))
    return found
