"""What the runner knows about the suites: suites.yml read into types, argument lists and output names.

A parameter is named as in suites.yml everywhere: campaign, run.json, report. ``None`` means the option is not given.
Suites are asked for by name; a name that is not in suites.yml is a UsageError.
"""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rtfiles.config import Config, load
from rtfiles.errors import UsageError

Value = str | int | None
Strings = Annotated[tuple[str, ...], Field(strict=False)]  # YAML has lists only

SUITES_FILE = Path(__file__).with_name("suites.yml")


class Option(Config):
    """One option of the programs: its flag and the values it takes."""

    flag: str
    type: Literal["int", "choice", "string"]
    default: Value
    help: str
    min: int = 0
    max: int = 0
    choices: Strings = ()

    @property
    def allowed(self) -> str:
        """What the option takes, for a message to the user."""
        if self.type == "int":
            return f"a whole number from {self.min} to {self.max}"
        if self.type == "choice":
            return f"one of {', '.join(self.choices)}"
        return "one line of text"


class Packages(Config):
    """ROS packages a suite needs to build and to run."""

    build: Strings
    run: Strings


class Suite(Config):
    """One suite: its programs, the parameters each takes, and what it writes."""

    summary: str
    measures: Literal["latency", "jitter"]
    programs: dict[str, Strings]
    output: str
    logs: Strings
    columns: Strings
    packages: Packages
    repeated: str | None = None
    """The program that runs once per subscriber; none: there are no subscribers."""
    launch: dict[str, Value] = Field(default_factory=dict)
    """Parameters that are not the program's default unless a campaign says otherwise."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Every parameter that one of the programs takes, each once, in the order of suites.yml."""
        return tuple(dict.fromkeys(key for keys in self.programs.values() for key in keys))


class Suites(Config):
    """The whole of suites.yml."""

    schema_number: Literal[1] = Field(alias="schema")
    options: dict[str, Option]
    suites: dict[str, Suite]

    @model_validator(mode="after")
    def _take_known_options(self) -> "Suites":
        for name, suite in self.suites.items():
            for key in suite.parameters:
                if key not in self.options:
                    raise ValueError(f"suites.{name}: unknown option {key!r}, known: {', '.join(self.options)}")
        return self


@functools.cache
def suites() -> Suites:
    """The suites of this version, read once."""
    return load(SUITES_FILE, Suites)


def suite(name: str) -> Suite:
    """The suite of this name. Raises UsageError that lists the known ones."""
    known = suites().suites
    if name not in known:
        raise UsageError(f"unknown suite {name!r}, known: {', '.join(known)}")
    return known[name]


def check(key: str, value: object, where: str) -> Value:
    """Return a parameter's value as the programs take it, or raise UsageError ``where: what it takes, what came``.

    `where` is the whole place, ``file: path.to.key``. A choice may come as a number (YAML's bare 0), a value that
    has no default may be None.
    """
    options = suites().options
    if key not in options:
        raise UsageError(f"{where}: unknown parameter {key!r}, known: {', '.join(options)}")
    option = options[key]
    if value is None and option.default is None:
        return None
    number = isinstance(value, int) and not isinstance(value, bool)
    if option.type == "int" and isinstance(value, int) and number and option.min <= value <= option.max:
        return value
    if option.type == "choice" and (number or isinstance(value, str)) and str(value) in option.choices:
        return str(value)
    if option.type == "string" and isinstance(value, str) and (value.isprintable() or not value):
        return value
    raise UsageError(f"{where}: {key} takes {option.allowed}, got {value!r}")


def argv(suite_name: str, program: str, parameters: Mapping[str, Value]) -> list[str]:
    """The program and its options; what is None or the default is left out, and so is what it does not take.

    A run of defaults thus asks for nothing but what the programs of 2014 know.
    """
    programs = suite(suite_name).programs
    if program not in programs:
        raise UsageError(f"unknown program {program!r} of {suite_name}, known: {', '.join(programs)}")
    words = [program]
    for key in programs[program]:
        option = suites().options[key]
        value = parameters.get(key)
        if value is not None and value != option.default:
            words += [option.flag, str(value)]
    return words


def output_name(suite_name: str, parameters: Mapping[str, Value]) -> str:
    """The name, without ending, of what such a run writes; the prefix, which may hold a folder, comes first."""
    keys = suite(suite_name).parameters
    values = {key: suites().options[key].default for key in keys}
    values |= {key: value for key, value in parameters.items() if key in values and value is not None}
    return str(values["prefix"]) + suite(suite_name).output.format_map(
        values
        | {
            "policy_suffix": "" if values["policy"] == "0" else f"-tnRT{values['policy']}",
            "busy_suffix": "-bm" if values.get("busy_mode") else "",
        }
    )


def log_names(suite_name: str, parameters: Mapping[str, Value]) -> list[str]:
    """The names of the logs a run with these parameters writes."""
    output = output_name(suite_name, parameters)
    return [f"{output}-{log}.log" for log in suite(suite_name).logs] or [f"{output}.log"]


@dataclass(frozen=True, kw_only=True, slots=True)
class LogName:
    """What the name of a log says; log is empty for a suite that writes one log only."""

    suite: str
    log: str
    parameters: dict[str, Value]


def read_log_name(name: str) -> LogName | None:
    """Take suite, parameters and log from the last part of a log's path; None when no suite names its logs so."""
    for suite_name in suites().suites:
        if found := _log_pattern(suite_name).fullmatch(name):
            parameters: dict[str, Value] = {}
            for key, text in found.groupdict(default="").items():
                if key == "busy_suffix":
                    parameters["busy_mode"] = 1 if text else 0
                elif key == "policy_suffix":
                    parameters["policy"] = text.removeprefix("-tnRT") or "0"
                elif key not in ("log", "prefix"):
                    parameters[key] = int(text)
            if found["prefix"]:
                parameters["prefix"] = found["prefix"]
            return LogName(suite=suite_name, log=found.groupdict().get("log") or "", parameters=parameters)
    return None


@functools.cache
def _log_pattern(suite_name: str) -> re.Pattern[str]:
    """The output template of a suite as a regular expression with a group for every field, prefix and log."""
    pattern = ""
    for text, field in re.findall(r"([^{]*)(?:\{(\w+)\})?", suite(suite_name).output):
        pattern += re.escape(text)
        if field == "policy_suffix":
            policies = "|".join(map(re.escape, suites().options["policy"].choices))
            pattern += f"(?P<policy_suffix>-tnRT(?:{policies}))?"
        elif field == "busy_suffix":
            pattern += "(?P<busy_suffix>-bm)?"
        elif field:
            pattern += rf"(?P<{field}>[0-9]{{1,10}})"
    logs = suite(suite_name).logs
    if logs:
        pattern += f"-(?P<log>{'|'.join(map(re.escape, logs))})"
    return re.compile(rf"(?P<prefix>.*?){pattern}\.log", re.DOTALL)
