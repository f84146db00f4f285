"""A campaign file, and its plan: every run with all of its parameters, made without a target."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from rtfiles.config import Config, Place, UserPath, matching, parse, read_yaml_with_place
from rtfiles.errors import UsageError
from rtfiles.wording import unknown
from rtrun.kinds.limits import MEASURING_PRIORITY_MAX, Seed
from rtrun.plan import conditions, suites
from rtrun.plan.goal import Goal, Time
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.observation import SUITE as OBSERVATION
from rtrun.plan.observation import (
    ObservationPlan,
    ObservedSystem,
    StreamDeadline,
    read_path,
    read_stream_deadline,
    read_subject,
)
from rtrun.plan.run import KernelName, Run, idle_twice, interleave, label, never_observed, order_by_kernel
from rtrun.plan.subject import SUITE_PROGRAMS
from rtrun.plan.topology.others import OTHER_NODES
from rtrun.plan.topology.planning import SUITE as TOPOLOGY
from rtrun.plan.topology.planning import plan_topology
from rtrun.plan.topology.reading import read_topology
from rtrun.plan.topology.topology import Topology
from rtrun.plan.trace import PARAMETER as TRACE_PARAMETER
from rtrun.plan.trace import SERIES as TRACE_SERIES
from rtrun.plan.trace import read_trace, too_few, traced, with_warm_ups

SUBSCRIBERS_MAX = 64  #: subscribers of a run
REPEATS_MAX = 10_000  #: repeats of a run
# At a second each, enough runs for a day. A few lists can multiply to many millions.
RUNS_MAX = 100_000  #: runs of a campaign
# Set by the runner alone.
RESERVED = ("prefix", "out_dir", "awaited_subscribers")
# What a variant may name in addition to values of a run: a folder of `rtgen suites build`, relative to the campaign
# file, and a shell file on the target that sets up ROS. If it names none, those of the target file are used.
VARIANT_KEYS = ("suites", "ros_setup")
# The suite that measures no deadline.
GAP_SEARCH = "hwlatdetect"
# How long to observe if the campaign does not set it.
OBSERVED_NS = 60 * 10**9

Entry = dict[str, Any]
Name = Annotated[
    str,
    matching(
        r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", "a name of at most 100 letters, digits and . _ -, a letter or digit first"
    ),
]


class Campaign(Config):
    """A campaign file. A run's value may be a list: one run is planned for each combination, in the order listed."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name
    order: Literal["listed", "interleaved"] = "listed"
    """interleaved: blocks of one repeat of each combination in an order drawn with `seed`, every other one reversed."""
    seed: Seed | None = None
    common: Entry = Field(default_factory=dict)
    """Values of every run that takes them; a run's own value wins."""
    runs: Annotated[list[Entry], Field(min_length=1)]
    exclude: list[Entry] = Field(default_factory=list)
    """Combinations to leave out of `runs`: those that have all values of one of these entries."""
    include: list[Entry] = Field(default_factory=list)
    """Runs on top of that; nothing is left out of them."""
    variants: dict[Name, Entry] = Field(default_factory=dict)
    """Every run is planned for each variant: other suites or another ROS (`VARIANT_KEYS`), other values of a run."""
    kernels: Annotated[list[KernelName], Field(min_length=1)] | None = None
    """Every run is planned for each kernel, and the target restarts into it; None: whatever kernel the target runs."""
    until: Goal | None = None
    """Measure each run again, round by round, until its deadline is proven or refuted."""
    subject: Annotated[ObservedSystem, BeforeValidator(read_subject)] | None = None
    """Whose programs each run observes; None: the programs of its suite measure."""
    topology: UserPath | None = None
    """A topology file, relative to this one: the graph of nodes that each run starts and measures."""
    for_ns: Time | None = Field(default=None, alias="for")
    """How long a run observes [1min]. Only campaigns with a subject or a topology have this and the next two."""
    deadlines: list[Annotated[StreamDeadline, BeforeValidator(read_stream_deadline)]] = Field(default_factory=list)
    paths: list[Annotated[tuple[str, ...], BeforeValidator(read_path)]] = Field(default_factory=list)
    """Topics whose reaction time is measured, from the first to the last."""
    loops: list[str] = Field(default_factory=list)
    """Programs, or PROGRAM/THREAD, whose loops are observed though they are not real-time and have no deadline."""

    @property
    def has_streams(self) -> bool:
        """Whether a run leaves several streams with deadlines of their own, instead of what one suite measures."""
        return self.subject is not None or self.topology is not None

    @property
    def for_s(self) -> float:
        """How long a run of streams measures, in seconds."""
        return (self.for_ns or OBSERVED_NS) / 1e9

    @property
    def observation(self) -> ObservationPlan | None:
        """What each run observes; None: the programs of its suite measure."""
        if self.subject is None:
            return None
        return ObservationPlan(
            for_s=self.for_s,
            system=self.subject,
            deadlines=tuple(self.deadlines),
            paths=tuple(self.paths),
            named_loops=tuple(self.loops),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """The own parts of a variant: a folder of suites here, and a shell file on the target that sets up ROS."""

    suites: Path | None = None
    ros_setup: str | None = None


def read_campaign(path: Path) -> tuple[Campaign, tuple[Run, ...]]:
    """Read a campaign file and plan it. Raises UsageError with every mistake found, one a line."""
    data, top = read_yaml_with_place(path)
    campaign = parse(data, Campaign, top)
    given = topology_path(campaign, path)
    return campaign, plan(campaign, top, read_topology(given).topology if given else None)


def topology_path(campaign: Campaign, path: Path) -> Path | None:
    """The topology file that a campaign in the file `path` names; None: it names none."""
    return path.parent / Path(campaign.topology).expanduser() if campaign.topology else None


def variants_of(campaign: Campaign, folder: Path) -> dict[str, Variant]:
    """The variants of a campaign by name; `folder` is that of its file."""
    return {
        name: Variant(
            suites=folder / Path(entry["suites"]).expanduser() if "suites" in entry else None,
            ros_setup=entry.get("ros_setup"),
        )
        for name, entry in campaign.variants.items()
    }


def plan(campaign: Campaign, origin: Place | str, topology: Topology | None = None) -> tuple[Run, ...]:
    """Return the runs in order; `topology` comes from the file that the campaign names.

    Raises UsageError ``origin:7: runs.0.key: what is wrong, what is allowed``.
    """
    errors: list[str] = []
    top = Place(origin) if isinstance(origin, str) else origin
    _check_subject(campaign, top, errors)
    _check_common(campaign, top / "common", errors)
    if campaign.until and campaign.until.of:
        # Traces are kept of the series that is judged, unless the campaign names another one.
        campaign = campaign.model_copy(update={"common": {TRACE_SERIES: campaign.until.of} | campaign.common})
    _check_variants(campaign, top / "variants", errors)
    if (campaign.order == "interleaved") != (campaign.seed is not None):
        errors.append(f"{top / 'seed'}: give one, a whole number, with order: interleaved, and only then")
    if campaign.kernels and len(set(campaign.kernels)) < len(campaign.kernels):
        errors.append(f"{top / 'kernels'}: names a kernel twice")
    listed = _runs_of(campaign.runs, campaign, top / "runs", errors)
    for number, pattern in enumerate(campaign.exclude):
        kept = [run for run in listed if not _matches(run, pattern)]
        if not pattern or len(kept) == len(listed):
            where = top / "exclude" / number
            errors.append(f"{where}: no run has all of {pattern}, so there is nothing to leave out")
        listed = kept
    listed += _runs_of(campaign.include, campaign, top / "include", errors)
    if topology is not None and campaign.subject is None:
        planned = plan_topology(
            topology, campaign.for_s, paths=campaign.paths, deadlines=campaign.deadlines, where=top, errors=errors
        )
        if planned and campaign.until and not planned.deadlines:
            errors.append(f"{top / 'until'}: give deadlines, here or in the topology: it measures until each is proven")
        of_topology: dict[str, suites.Value] = {"topology": topology.name}
        listed = [
            replace(
                run,
                subject=planned.beside(str(run.parameters[OTHER_NODES])),
                parameters=of_topology | dict(run.parameters),
            )
            for run in listed
            if planned
        ]
    if len(listed) > RUNS_MAX:
        errors.append(f"{top}: makes {len(listed)} runs, at most {RUNS_MAX} are allowed")
    if campaign.until:
        _check_goal(campaign, listed, top / "until", errors)
    if not errors and not listed:
        errors.append(f"{top / 'exclude'}: leaves no run")
    refusals = (never_observed(run) or too_few(run) or idle_twice(run) for run in listed)
    errors += dict.fromkeys(f"{top}: {refusal}" for refusal in refusals if refusal)
    if errors:
        raise UsageError("\n".join(errors))
    width = max(3, len(str(len(listed))))
    named = [replace(run, name=f"{number:0{width}}-{label(run)}") for number, run in enumerate(listed, start=1)]
    ordered = named if campaign.seed is None else interleave(named, campaign.seed)
    return tuple(with_warm_ups(order_by_kernel(ordered, campaign.kernels or ())))


def _runs_of(entries: Sequence[Entry], campaign: Campaign, where: Place, errors: list[str]) -> list[Run]:
    """The runs of these entries. Stops once the limit is exceeded, so at most one entry's runs are above it."""
    runs: list[Run] = []
    for number, entry in enumerate(entries):
        if len(runs) <= RUNS_MAX:
            of_entry = list(_of_variants(entry, campaign, where / number, errors))
            runs += [replace(run, kernel=kernel) for kernel in campaign.kernels or (None,) for run in of_entry]
    return runs


def _of_variants(entry: Entry, campaign: Campaign, where: Place, errors: list[str]) -> Iterator[Run]:
    """Yield the runs of an entry for each variant, or just once where there are none."""
    if not campaign.variants:
        yield from _combinations(entry, campaign, where, errors)
    for name, variant in campaign.variants.items():
        values = {key: value for key, value in variant.items() if key not in VARIANT_KEYS}
        programs = tuple(f"{key}: {variant[key]}" for key in VARIANT_KEYS if key in variant)
        for run in _combinations(entry, campaign, where, errors, values):
            yield replace(run, variant=name, variant_of=programs)


def _combinations(
    entry: Entry, campaign: Campaign, where: Place, errors: list[str], overrides: Entry | None = None
) -> Iterator[Run]:
    """Yield the runs of an entry, all with empty names; `overrides` win over its values if it takes them."""
    observation = campaign.observation
    of_streams = OBSERVATION if campaign.subject else TOPOLOGY
    if campaign.has_streams:
        entry = {"suite": of_streams} | entry
    of_suite = str(entry.get("suite", ""))
    started = suites.suites().suites | suites.baselines().suites
    if campaign.has_streams and of_suite != of_streams:
        what = "subject" if campaign.subject else "topology"
        errors.append(f"{where / 'suite'}: with {what} nothing but that is measured: leave the suite out")
        return
    if not campaign.has_streams and of_suite not in started:
        errors.append(f"{where / 'suite'}: {unknown('suite', of_suite, known=started)}")
        return
    suite = suites.suite(of_suite)
    takes = _takes(suite)
    if TRACE_PARAMETER in entry:
        errors.append(f"{where / TRACE_PARAMETER}: write {_trace_instead(entry[TRACE_PARAMETER])}")
        return
    settings = conditions.conditions().settings
    keys = (*_given(takes), *([] if observation is None else ["trace"]), "condition", "repeats", *settings)
    if refused := [key for key in entry if key not in ("suite", *keys)]:
        taker = f"a run with {'subject' if observation else 'topology'}" if campaign.has_streams else entry["suite"]
        allowed = keys if campaign.has_streams else ("suite", *keys)
        errors.append(_unknown_keys(where, refused, allowed, f"{taker} takes"))
    merged = campaign.common | entry | (overrides or {})
    axes = {key: _axis(where / key, key, merged[key], errors) for key in merged if key in keys}
    through = [str(value) for value in axes.get("middleware", [suite.middleware])]
    for unused in [key for key in takes if key in entry and not any(_is_taken(key, name) for name in through)]:
        its_middlewares = ", ".join(name for name in middlewares() if suites.options()[unused].is_taken_through(name))
        errors.append(f"{where / unused}: is for middleware {its_middlewares}, and this run's is {', '.join(through)}")
    repeats = axes.pop("repeats", [1])
    if len(repeats) > 1:
        errors.append(f"{where / 'repeats'}: one whole number, not a list")
    if not all(axes.values()) or not repeats:
        return
    for name in through:
        if suite.kind and suite.kind not in (kinds := middlewares()[name].kinds):
            has = ", ".join(kinds)
            errors.append(f"{where / 'middleware'}: {name} measures {has}, and {entry['suite']} is of {suite.kind}")
            return
    number = math.prod(map(len, axes.values())) * int(repeats[0] or 1)
    if number > RUNS_MAX:
        errors.append(f"{where}: makes {number} runs, at most {RUNS_MAX} are allowed")
        return
    defaults = {key: suites.options()[key].default for key in takes if key != "subscribers"}
    defaults |= suite.launch | ({"subscribers": 1} if suite.repeated else {})
    seen: set[tuple[suites.Value, ...]] = set()
    for values in itertools.product(*axes.values()):
        given = dict(zip(axes, values, strict=True))
        condition = str(given.get("condition", conditions.IDLE))
        taken = {key: given.get(key, settings[key].default) for key in conditions.settings_of(condition)}
        middleware = str(given.get("middleware", suite.middleware))
        parameters = defaults | {key: value for key, value in given.items() if key in takes}
        parameters = {key: value for key, value in parameters.items() if _is_taken(key, middleware)}
        # Combinations that differ only in values that the condition or the middleware does not take are the same run.
        trace = str(given.get("trace") or "")
        if (key := (*parameters.values(), condition, *taken.values(), trace)) in seen:
            continue
        seen.add(key)
        run = Run(
            name="",
            suite=of_suite,
            parameters=parameters,
            condition=condition,
            settings=taken,
            trace=trace,
            subject=observation or SUITE_PROGRAMS,
        )
        for repeat in range(1, int(repeats[0] or 1) + 1):
            yield from traced(replace(run, repeat=repeat))


def _matches(run: Run, pattern: Entry) -> bool:
    own = ("suite", "condition", "variant", "kernel", "trace")
    has = {**{key: getattr(run, key) for key in own}, **run.parameters, **run.settings}
    return all(
        key in has and str(has[key]) in map(str, value if isinstance(value, list) else [value])
        for key, value in pattern.items()
    )


def _takes(suite: suites.Suite) -> tuple[str, ...]:
    keys = [key for key in suite.parameters if key not in RESERVED]
    keys += ["subscribers"] if suite.repeated else []
    return (*keys, *([] if suite.is_baseline or suite.subject == "attached" else ["middleware"]))


def _is_taken(key: str, middleware: str) -> bool:
    return key == "subscribers" or suites.options()[key].is_taken_through(middleware)


def _given(takes: Sequence[str]) -> tuple[str, ...]:
    """The keys by which a campaign sets the parameters of a suite."""
    return tuple("trace" if key == TRACE_PARAMETER else key for key in takes)


def _trace_instead(value: object) -> str:
    return f"trace: {{above: {value}us}}, or a quantile as {{above: p99.9}}: it is found in a short warm-up"


def _unknown_keys(where: Place, keys: Sequence[str], known: Sequence[str], label: str = "allowed") -> str:
    return f"{replace(where, line=(where / keys[0]).line)}: {unknown('key', *keys, known=known, label=label)}"


def _check_subject(campaign: Campaign, where: Place, errors: list[str]) -> None:
    """Check the keys that belong only to campaigns with a subject or a topology."""
    given = {"for": campaign.for_ns, "deadlines": campaign.deadlines, "paths": campaign.paths}
    if not campaign.has_streams and (key := next((key for key, value in given.items() if value), None)):
        errors.append(f"{where / key}: is for campaigns with subject or topology: give one, or leave this out")
    if campaign.subject is not None and campaign.topology is not None:
        errors.append(f"{where / 'topology'}: a campaign has a subject or a topology, not both")
    if campaign.subject is None and campaign.loops:
        errors.append(f"{where / 'loops'}: is for campaigns with subject: give one, or leave this out")
    if campaign.until and campaign.subject is not None and not campaign.deadlines:
        errors.append(f"{where / 'until'}: give deadlines: it measures until each is proven or refuted")
    named = [(deadline.kind, deadline.name) for deadline in campaign.deadlines]
    for number, deadline in enumerate(campaign.deadlines):
        if named.index(named[number]) < number:
            errors.append(f"{where / 'deadlines' / number}: {deadline.text}: it has another deadline before: give one")
        if campaign.topology is None and deadline.stream.is_of_topologies:
            errors.append(f"{where / 'deadlines' / number}: {deadline.kind}: is of topologies: no probe sees it")


def _check_common(campaign: Campaign, where: Place, errors: list[str]) -> None:
    known = _common_keys()
    if TRACE_PARAMETER in campaign.common:
        errors.append(f"{where / TRACE_PARAMETER}: write {_trace_instead(campaign.common[TRACE_PARAMETER])}")
        return
    if refused := [key for key in campaign.common if key not in known]:
        errors.append(_unknown_keys(where, refused, known))


def _common_keys() -> list[str]:
    known = [*_given([key for key in suites.options() if key not in RESERVED]), "subscribers"]
    return [*known, "condition", "repeats", *conditions.conditions().settings]


def _check_variants(campaign: Campaign, where: Place, errors: list[str]) -> None:
    known = [*VARIANT_KEYS, *(key for key in _common_keys() if key != "repeats")]
    for name, variant in campaign.variants.items():
        if refused := [key for key in variant if key not in known]:
            errors.append(_unknown_keys(where / name, refused, known))
        for key, value in variant.items():
            if key in VARIANT_KEYS and not (isinstance(value, str) and value):
                errors.append(f"{where / name / key}: takes a path, got {value!r}")
            if isinstance(value, list):
                errors.append(f"{where / name / key}: one value, not a list: each variant is one of two sides")
    if len(campaign.variants) == 1:
        errors.append(f"{where}: give at least two, or none")
    if campaign.variants and campaign.order != "interleaved":
        errors.append(f"{where}: give order: interleaved and a seed, else time is compared with time")


def _check_goal(campaign: Campaign, runs: Sequence[Run], where: Place, errors: list[str]) -> None:
    if campaign.order != "interleaved":
        errors.append(f"{where}: give order: interleaved and a seed: its rounds are drawn with it")
    if any(run.repeat > 1 for run in runs):
        errors.append(f"{where}: takes no repeats: each round is one")
    of_goal = campaign.until.model_fields_set if campaign.until else set()
    if not campaign.has_streams and "deadline_ns" not in of_goal:
        errors.append(f"{where / 'deadline'}: is missing")
    if campaign.has_streams and (own := of_goal & {"deadline_ns", "of"}):
        key = "of" if "of" in own else "deadline"
        errors.append(f"{where / key}: leave it out: each stream has its own deadline")
    if any(run.parameters.get(suites.ALLOCATIONS) for run in runs):
        errors.append(f"{where}: takes no allocations: counting them costs time, and would be in the answer")
    if any(run.trace for run in runs):
        errors.append(f"{where}: takes no trace: tracing costs time, and would be in the answer")
    if campaign.kernels and len(campaign.kernels) > 1:
        errors.append(f"{where}: takes one kernel: give each kernel a campaign of its own")
    for name in dict.fromkeys(run.suite for run in runs):
        try:
            suites.suite(name).judged(campaign.until.of if campaign.until else None)
        except UsageError as error:
            errors.append(f"{where / 'of'}: {name} {error}")
    if any(run.suite == GAP_SEARCH for run in runs):
        errors.append(f"{where}: {GAP_SEARCH} measures no deadline, leave it out")


def _axis(where: Place, key: str, value: Any, errors: list[str]) -> list[suites.Value]:
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


def _check(where: Place, key: str, value: Any) -> suites.Value:
    if key == "trace":
        return read_trace(value, where)
    if key == "condition":
        conditions.condition(value, str(where))
        return str(value)
    if key in conditions.conditions().settings:
        return conditions.check(key, value, str(where))
    limits = {"subscribers": SUBSCRIBERS_MAX, "priority": MEASURING_PRIORITY_MAX, "repeats": REPEATS_MAX}
    for limited, limit in limits.items():
        if key == limited and not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= limit):
            raise UsageError(f"{where}: {key} takes a whole number from 1 to {limit}, got {value!r}")
    if key in ("subscribers", "repeats"):
        return int(value)
    accepted = suites.check(key, value, str(where))
    conditions.check_cpus(key, accepted, str(where))
    return accepted
