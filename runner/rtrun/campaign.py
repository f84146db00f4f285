"""A campaign file, and the plan that follows from it: every run with all its parameters, known before a target is."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from rtfiles.config import Config, parse, read_yaml
from rtfiles.errors import UsageError
from rtrun import suites

SUBSCRIBERS_MAX = 64
# The ROS master needs the priority above the suites' (thesis 4.4), and 99 belongs to the kernel.
PRIORITY_MAX = 97
# The runner names the output and knows where it is.
RESERVED = ("prefix", "out_dir")


class Campaign(Config):
    """A campaign file. A run's value may be a list: one run is planned for each combination, in the order listed."""

    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    common: dict[str, Any] = Field(default_factory=dict)
    """Parameters of every run whose suite takes them; a run's own value wins."""
    runs: Annotated[list[dict[str, Any]], Field(min_length=1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One planned run: `parameters` holds every parameter of its suite, and `subscribers` where it has some."""

    name: str
    suite: str
    parameters: Mapping[str, suites.Value]

    @property
    def expected_s(self) -> float:
        """How long the measuring alone should take, in seconds."""
        number = {key: value for key, value in self.parameters.items() if isinstance(value, int)}
        each_s = number["timeout_us"] / 1e6 if "timeout_us" in number else 1.0 / number["frequency_hz"]
        return number["repetitions"] * each_s + number.get("start_delay_s", 0)


def read_campaign(path: Path) -> tuple[Campaign, tuple[Run, ...]]:
    """Read a campaign file and plan it. Raises UsageError with every mistake found, one a line."""
    campaign = parse(read_yaml(path), Campaign, str(path))
    return campaign, plan(campaign, str(path))


def plan(campaign: Campaign, origin: str) -> tuple[Run, ...]:
    """Return the runs in their order. Raises UsageError ``origin: runs.0.key: what is wrong, what is allowed``."""
    errors: list[str] = []
    _check_common(campaign, origin, errors)
    found: list[tuple[str, dict[str, suites.Value]]] = []
    for number, entry in enumerate(campaign.runs):
        where = f"{origin}: runs.{number}"
        try:
            suite = suites.suite(str(entry.get("suite", "")))
        except UsageError as error:
            errors.append(f"{where}.suite: {error}")
            continue
        takes = _takes(suite)
        own = {key: value for key, value in entry.items() if key != "suite"}
        if unknown := [key for key in own if key not in takes]:
            names = ", ".join(map(repr, unknown))
            errors.append(f"{where}: unknown key {names}, {entry['suite']} takes: suite, {', '.join(takes)}")
        inherited = {key: value for key, value in campaign.common.items() if key in takes}
        axes = {
            key: _axis(f"{where}.{key}", key, value, errors) for key, value in (inherited | own).items() if key in takes
        }
        defaults = {key: suites.suites().options[key].default for key in takes if key != "subscribers"}
        defaults |= suite.launch | ({"subscribers": 1} if suite.repeated else {})
        for values in itertools.product(*axes.values()):
            found.append((entry["suite"], defaults | dict(zip(axes, values, strict=True))))
    if errors:
        raise UsageError("\n".join(errors))
    width = max(3, len(str(len(found))))
    return tuple(
        Run(name=f"{number:0{width}}-{_label(suite, parameters)}", suite=suite, parameters=parameters)
        for number, (suite, parameters) in enumerate(found, start=1)
    )


def _takes(suite: suites.Suite) -> tuple[str, ...]:
    keys = tuple(key for key in suite.parameters if key not in RESERVED)
    return (*keys, "subscribers") if suite.repeated else keys


def _check_common(campaign: Campaign, origin: str, errors: list[str]) -> None:
    known = [*(key for key in suites.suites().options if key not in RESERVED), "subscribers"]
    if unknown := [key for key in campaign.common if key not in known]:
        errors.append(f"{origin}: common: unknown key {', '.join(map(repr, unknown))}, allowed: {', '.join(known)}")


def _axis(where: str, key: str, value: Any, errors: list[str]) -> list[suites.Value]:
    values = value if isinstance(value, list) else [value]
    if not values:
        errors.append(f"{where}: the list is empty, give at least one value")
    checked: list[suites.Value] = []
    for item in values:
        try:
            checked.append(_check(where, key, item))
        except UsageError as error:
            errors.append(str(error))
    return checked


def _check(where: str, key: str, value: Any) -> suites.Value:
    for limited, limit in (("subscribers", SUBSCRIBERS_MAX), ("priority", PRIORITY_MAX)):
        if key == limited and not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= limit):
            raise UsageError(f"{where}: {key} takes a whole number from 1 to {limit}, got {value!r}")
    return value if key == "subscribers" else suites.check(key, value, where)


def _label(suite: str, parameters: Mapping[str, suites.Value]) -> str:
    name = suites.output_name(suite, parameters)
    subscribers = parameters.get("subscribers")
    return f"{name}-{subscribers}sub" if subscribers is not None else name
