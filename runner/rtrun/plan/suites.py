"""The suites, read from suites.yml: their options, argument lists and output names.

A parameter has its name of suites.yml everywhere: campaign, run.json, report. ``None`` means the option is not given.
A suite that is not in suites.yml is a UsageError.
"""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from rtfiles.config import Config, load_own
from rtfiles.errors import UsageError
from rtfiles.wording import did_you_mean, unknown
from rtrun.kinds.kind import MeasurementKind
from rtrun.kinds.known import KINDS, called
from rtrun.kinds.lateness import Measure, judged
from rtrun.kinds.limits import CPU_DMA_LATENCY_MAX_US, PID_MAX, RT_PRIORITY_MAX
from rtrun.plan.middleware.description import DEFAULT, NONE, middleware_names, middlewares
from rtrun.plan.quantities import INTERVAL_MAX_US

Value = str | int | None
Strings = Annotated[tuple[str, ...], Field(strict=False)]  # YAML has lists only

ALLOCATIONS = "allocations"
"""The parameter of runs that count allocations. Counting costs time: their times are not judged."""

SUITES_FILE = Path(__file__).with_name("suites.yml")
BASELINES_FILE = Path(__file__).with_name("baselines.yml")
OBSERVED_FILE = Path(__file__).with_name("observed.yml")

# Options that do not change what is measured: runs that differ only in these are alike.
NOT_TELLING = ("repetitions", "prefix", "out_dir", "start_delay_s", "idle_timeout_s", "trace_of")


# The highest values that a file of another program may state: such programs accept more than ours and baselines.
_HIGHEST_OF_OTHERS = {
    "priority": RT_PRIORITY_MAX,
    "interval_us": INTERVAL_MAX_US,
    "threads": PID_MAX,
    "cpu_dma_latency_us": CPU_DMA_LATENCY_MAX_US,
}

Subject = Literal["started", "attached"]
"""What a run measures: programs that it starts, or programs that run already."""
# A graph of nodes has no samples of its own; its streams have them.
_GRAPH = "topology"


class Option(Config):
    """One option of the programs: its flag and the values it takes."""

    type: Literal["int", "choice", "string"]
    default: Value
    help: str
    flag: str = ""
    since: str = ""
    """The version that first took it, where targets may have an older one: their program is asked by its --help."""
    environment: str = ""
    """The environment variable that passes it instead of a flag."""
    preload: str = ""
    """The library of rt_tests_sampler that is preloaded into the programs if the option has a value."""
    through: Strings = ()
    """Only the programs of these middlewares take it; none: the programs of all middlewares."""
    not_through: Strings = ()
    """The middlewares whose programs do not take it."""
    min: int = 0
    max: int = 0
    choices: Strings = ()
    pattern: str = ""
    """The pattern of a text that is not empty; none: any line."""

    def is_taken_through(self, middleware: str) -> bool:
        """Whether the programs of a middleware take it."""
        return (not self.through or middleware in self.through) and middleware not in self.not_through

    @property
    def is_of_2014(self) -> bool:
        """Whether the programs of 2014 may have it: their options have short flags, later ones have long flags."""
        return not self.flag.startswith("--")

    @property
    def allowed(self) -> str:
        """The values that the option takes, for a message to the user."""
        if self.type == "int":
            return f"a whole number from {self.min} to {self.max}"
        if self.type == "choice":
            return f"one of {', '.join(self.choices)}"
        return f"a text like {self.pattern}" if self.pattern else "one line of text"

    def accept(self, value: object) -> Value:
        """Return a value as the programs take it. Raises ValueError.

        A choice may be a number (YAML's bare 0). If the option has no default, the value may be None.
        """
        number = isinstance(value, int) and not isinstance(value, bool)
        if value is None and self.default is None:
            return None
        if self.type == "int" and isinstance(value, int) and number and self.min <= value <= self.max:
            return value
        if self.type == "choice" and (number or isinstance(value, str)) and str(value) in self.choices:
            return str(value)
        if self.type == "string" and (number or isinstance(value, str)):
            text = str(value)
            if not text or (text.isprintable() and (not self.pattern or re.fullmatch(self.pattern, text, re.ASCII))):
                return text
        hint = did_you_mean([value], self.choices) if isinstance(value, str) else ""
        raise ValueError(f"takes {self.allowed}, got {value!r}{',' if hint else ''}{hint}")


def _check_kind(name: str) -> str:
    if name not in (*KINDS, _GRAPH):
        raise ValueError(unknown("kind", name, known=[*KINDS]))
    return name


class Suite(Config):
    """One suite: its programs, the parameters each takes, and what it writes; or what is observed of other programs."""

    summary: str
    kind: Annotated[str, AfterValidator(_check_kind)] | None = None
    """How its samples are read (rtrun.kinds); None: it writes none, as a baseline."""
    subject: Subject = "started"
    measures: Annotated[tuple[Measure, ...], Field(strict=False, min_length=1)]
    """The values that a question may be about; by default the first one."""
    programs: dict[str, Strings] = Field(default_factory=dict)
    output: str = ""
    logs: Strings = ()
    columns: Strings
    program_json: dict[str, str] = Field(default_factory=dict)
    """For programs without samples: the part of their json's name between the output and ``.json``."""
    repeated: str | None = None
    """The program that runs once per subscriber; none: there are no subscribers."""
    starts_after: dict[str, str] = Field(default_factory=dict)
    """Program to the one that must be ready before it starts, because that one receives what it sends."""
    launch: dict[str, Value] = Field(default_factory=dict)
    """Parameters that a campaign does not give, but that differ from the program's default."""
    is_baseline: bool = Field(default=False, alias="baseline")
    """Whether it is a tool of the target with options of its own, measured to compare the suites with it."""
    always: Strings = ()
    """Arguments that a baseline always gets."""
    unset: dict[str, str] = Field(default_factory=dict)
    """The argument that a baseline gets for a parameter without a value."""
    kernel: str = ""
    """The kernel option that a baseline needs."""
    flags: dict[str, str] = Field(default_factory=dict)
    values: dict[str, str] = Field(default_factory=dict)

    @property
    def middleware(self) -> str:
        """The middleware that it measures through if no other one is named."""
        return NONE if self.is_baseline or self.subject == "attached" else DEFAULT

    @property
    def stages(self) -> tuple[tuple[str, ...], ...]:
        """Its programs in the order in which they start: a stage starts when all programs before it are ready."""
        first = tuple(program for program in self.programs if program not in self.starts_after)
        then = tuple(program for program in self.programs if program in self.starts_after)
        return (first, then) if then else (first,)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Every parameter that one of the programs takes, each once, in the order of suites.yml."""
        return tuple(dict.fromkeys(key for keys in self.programs.values() for key in keys))

    def judged(self, measure: Measure | None) -> Measure:
        """The values that a question is about. Raises UsageError if the suite does not measure them."""
        return judged(self.measures, measure)


class Suites(Config):
    """The whole of suites.yml."""

    schema_number: Literal[1] = Field(alias="schema")
    options: dict[str, Option]
    suites: dict[str, Suite]


@functools.cache
def suites() -> Suites:
    """The suites of this version, read once."""
    loaded = load_own(SUITES_FILE, Suites)
    _check_options(loaded, loaded.options)
    return loaded


@functools.cache
def baselines() -> Suites:
    """The baselines that the suites are compared with, read once."""
    loaded = load_own(BASELINES_FILE, Suites)
    _check_options(loaded, suites().options | loaded.options)
    return loaded


@functools.cache
def observed() -> Suites:
    """The suites that make streams, and those of each kind of stream, read once."""
    loaded = load_own(OBSERVED_FILE, Suites)
    streams = {
        kind.stream.suite: Suite(
            summary=kind.stream.summary,
            kind=name,
            subject="attached",
            measures=tuple(kind.called.values()),
            columns=kind.stream.columns,
        )
        for name, kind in KINDS.items()
        if kind.stream
    }
    return loaded.model_copy(update={"suites": loaded.suites | streams})


@functools.cache
def described_suites() -> dict[str, Suite]:
    """Everything with readable samples and figures, by name: suites, baselines, and kinds of streams."""
    return suites().suites | baselines().suites | observed().suites


def _check_options(listed: Suites, known: Mapping[str, Option]) -> None:
    for name, described in listed.suites.items():
        for key in described.parameters:
            if key not in known:
                raise UsageError(f"suites.{name}: {unknown('option', key, known=known)}")


@functools.cache
def options() -> dict[str, Option]:
    """Every option of a suite or a baseline, by the key used in campaigns, JSON and reports.

    The middleware is no option of a program: each has programs of its own.
    """
    choices = tuple(name for name in middleware_names() if name != NONE)
    own = {"middleware": Option(type="choice", choices=choices, default=DEFAULT, help="through what a suite measures")}
    return suites().options | baselines().options | observed().options | own


def find_suite(name: str) -> Suite | None:
    """The suite, baseline or observed kind of this name; None for an unknown name."""
    # Only the files that are needed to find the name are read.
    return next((load().suites[name] for load in (suites, baselines, observed) if name in load().suites), None)


def kind_of(name: str) -> MeasurementKind | None:
    """The kind of a suite by its name; None if the suite is not known or writes no samples."""
    described = find_suite(name)
    return KINDS.get(described.kind) if described and described.kind else None


def in_words(name: str, series: str) -> str:
    """What the values of a series of a suite are: "lateness of the timer"."""
    kind = kind_of(name)
    return f"{called(series) or series.replace('_', ' ')} {kind.subject if kind else f'by {name}'}"


def suite(name: str) -> Suite:
    """The suite, baseline or observed kind of this name. Raises UsageError that lists the known ones."""
    if known := find_suite(name):
        return known
    raise UsageError(unknown("suite", name, known=described_suites()))


def defaults_of(name: str) -> dict[str, Value]:
    """The defaults of the options of a suite; a baseline has some of its own."""
    described = suite(name)
    own = described.launch if described.is_baseline else {}
    return {key: option.default for key, option in options().items()} | own


def middleware_of(suite_name: str, parameters: Mapping[str, Value]) -> str:
    """The name of the middleware of a run with these parameters."""
    return str(parameters.get("middleware") or suite(suite_name).middleware)


def executable(suite_name: str, program: str, parameters: Mapping[str, Value]) -> str:
    """The name of a suite's program for the middleware of a run with these parameters."""
    name = middleware_of(suite_name, parameters)
    return middlewares()[name].executable.format(program=program, middleware=name)


def measures(name: str) -> tuple[Measure, ...]:
    """What a suite, a baseline or another program measures; an unknown program measures a latency."""
    known = find_suite(name)
    return known.measures if known else ("latency",)


def check_numbers(values: dict[str, Value], known: Mapping[str, Option]) -> dict[str, Value]:
    """Return values by key as they are. Raises ValueError if the option of a key does not take such a number."""
    for key, value in values.items():
        if isinstance(value, int) and key in known and known[key].type == "int":
            try:
                known[key].accept(value)
            except ValueError as error:
                raise ValueError(f"{key} {error}") from None
    return values


def _check_parameters(values: dict[str, Value]) -> dict[str, Value]:
    of_others = {
        key: value
        for key, value in values.items()
        if isinstance(value, int) and 1 <= value <= _HIGHEST_OF_OTHERS.get(key, 0)
    }
    check_numbers({key: value for key, value in values.items() if key not in of_others}, options())
    return values


def _check_asked(number: int) -> int:
    return number and int(options()["repetitions"].accept(number) or 0)


Parameters = Annotated[dict[str, Value], AfterValidator(_check_parameters)]
"""Parameters of a suite, by key."""
Asked = Annotated[int, Field(ge=0), AfterValidator(_check_asked)]
"""How many measurements a suite was asked for."""


def check(key: str, value: object, where: str) -> Value:
    """Return a parameter's value as the programs take it, or raise UsageError ``where: what it takes, what came``.

    `where` is the whole place, ``file: path.to.key``.
    """
    if key not in options():
        raise UsageError(f"{where}: {unknown('parameter', key, known=options())}")
    try:
        return options()[key].accept(value)
    except ValueError as error:
        raise UsageError(f"{where}: {key} {error}") from None


def argv(suite_name: str, program: str, parameters: Mapping[str, Value]) -> list[str]:
    """The program and its options. Values that are None or the default, or that it does not take, are left out.

    So a run with defaults uses only options that the programs of 2014 know. A baseline has defaults of its own and gets
    all options, but no priority without a real-time policy.
    """
    described = suite(suite_name)
    if program not in described.programs:
        raise UsageError(f"unknown program {program!r} of {suite_name}, known: {', '.join(described.programs)}")
    if described.is_baseline:
        return [program, *described.always, *_explicit(suite_name, program, parameters)]
    words = [program]
    middleware = middleware_of(suite_name, parameters)
    for key in described.programs[program]:
        option = suites().options[key]
        value = parameters.get(key)
        if option.flag and option.is_taken_through(middleware) and value is not None and value != option.default:
            words += [option.flag, str(value)]
    return words


def environment(parameters: Mapping[str, Value]) -> tuple[tuple[str, str], ...]:
    """The environment variables that pass some of these parameters to programs."""
    known = options()
    given = {key: value for key, value in parameters.items() if key in known and value not in (None, "")}
    return tuple((known[key].environment, str(value)) for key, value in given.items() if known[key].environment)


def preloaded(parameters: Mapping[str, Value]) -> tuple[str, ...]:
    """The libraries of rt_tests_sampler that are preloaded into programs with these parameters."""
    known = options()
    given = [key for key, value in parameters.items() if key in known and value not in (None, "")]
    return tuple(known[key].preload for key in given if known[key].preload)


def _explicit(baseline: str, program: str, parameters: Mapping[str, Value]) -> list[str]:
    words, described, defaults = [], suite(baseline), defaults_of(baseline)
    for key in described.programs[program]:
        value = parameters.get(key, defaults[key])
        if value is None and key in described.unset:
            words.append(described.unset[key])
        elif value not in (None, "") and not (key == "priority" and not is_real_time(parameters)):
            if options()[key].type == "choice":
                value = described.values.get(str(value), value)
            words.append(f"{described.flags.get(key, options()[key].flag)}={value}")
    return words


def output_name(suite_name: str, parameters: Mapping[str, Value]) -> str:
    """The name of such a run's output, without ending. It begins with the prefix, which may hold a folder."""
    keys = suite(suite_name).parameters
    values = {key: options()[key].default for key in keys}
    values |= {key: value for key, value in parameters.items() if key in values and value is not None}
    return str(values.get("prefix") or "") + suite(suite_name).output.format_map(
        values
        | {
            "policy_suffix": f"-tnRT{values['policy']}" if is_real_time(values) else "",
            "busy_suffix": "-bm" if values.get("busy_mode") else "",
        }
    )


def log_names(suite_name: str, output: str) -> list[str]:
    """The names of the logs that an output of a suite has."""
    return [f"{output}-{log}.log" for log in suite(suite_name).logs] or [f"{output}.log"]


def program_json_names(suite_name: str, parameters: Mapping[str, Value]) -> dict[str, str]:
    """The names of the json files that the programs without samples write in such a run, by program."""
    output = output_name(suite_name, parameters)
    return {program: f"{output}-{ending}.json" for program, ending in suite(suite_name).program_json.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class LogFacts:
    """What can be read from the name of a log; `log` is empty for a suite that writes one log only."""

    suite: str
    log: str
    parameters: dict[str, Value]


def read_log_name(name: str) -> LogFacts | None:
    """Read suite, parameters and log from the name of a log; None for a name that no suite gives."""
    for suite_name in suites().suites:
        if match := _log_pattern(suite_name).fullmatch(name):
            parameters: dict[str, Value] = {}
            for key, text in match.groupdict(default="").items():
                if key == "busy_suffix":
                    parameters["busy_mode"] = 1 if text else 0
                elif key == "policy_suffix":
                    parameters["policy"] = text.removeprefix("-tnRT") or "0"
                elif key not in ("log", "prefix"):
                    parameters[key] = int(text)
            if match["prefix"]:
                parameters["prefix"] = match["prefix"]
            try:
                _check_parameters(parameters)
            except ValueError:
                return None
            return LogFacts(suite=suite_name, log=match.groupdict().get("log") or "", parameters=parameters)
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


def is_real_time(parameters: Mapping[str, Value]) -> bool:
    """Whether a run with these parameters asks for a real-time policy."""
    return parameters.get("policy", "0") != "0"


def period_of(parameters: Mapping[str, Value]) -> float | None:
    """The least time of one measurement according to the parameters, in ns; None if they do not tell."""
    for key in ("timeout_us", "interval_us"):
        value = parameters.get(key)
        if isinstance(value, int) and value > 0:
            return value * 1e3
    frequency_hz = parameters.get("frequency_hz")
    return 1e9 / frequency_hz if isinstance(frequency_hz, int) and frequency_hz > 0 else None


def telling_parameters(parameters: Mapping[str, Value]) -> dict[str, Value]:
    """The parameters that determine what was measured: runs with equal ones are alike.

    An option that was not given is left out, because records from before it was added do not have it.
    """
    return {key: value for key, value in parameters.items() if key not in NOT_TELLING and value is not None}
