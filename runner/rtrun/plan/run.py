"""One planned run: what is measured, how long that takes, what it is called.

For several runs: their order, the blocks that are measured together, and the digest that identifies the runs.
"""

import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal

from rtrun.plan import conditions, suites
from rtrun.plan.subject import SUITE_PROGRAMS, Subject, SuitePrograms
from rtrun.plan.topology.others import OTHER_NODES
from rtrun.plan.topology.planning import TopologyPlan

KernelName = Literal["standard", "rt"]
"""rt: the kernel calls itself PREEMPT_RT; standard: it does not."""

UNTRACED = "off"

# Time of one measurement in addition to its timeout: the latency of the timer, and arming it again (75 to 170 us on a
# PC). No measurement takes less, however short its period is.
MEASUREMENT_COST_S = 200e-6
# Time before the first run: the target is reached and inspected, and gets what it lacks. This and the next two were
# measured on a PC with suites deployed (10 runs of demo.yml, 12 of smoke.yml); an emulated board takes more.
SET_UP_S = 1.5
# Time per run: ROS nodes start and end, the runner starts the programs and copies their files.
START_AND_END_S = 0.6
# Additional time per run under a condition that loads the target: the loads are started and ended, on CPUs that they
# keep busy.
LOADS_S = 0.7
# Time per restart of the target, if nothing better is known: it shuts down, boots, and is prepared for runs again. A
# small board takes half of it, a server more because of its firmware.
RESTART_S = 60.0
# Increase this when the canonical form changes, or a default of a field or option, which the form leaves out.
DIGEST_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One planned run: `parameters` holds every parameter of its suite, and `subscribers` where it has some.

    `settings` belong to the condition, `repeat` counts from 1, `seed` drew an interleaved order. `variant` is empty and
    `kernel` None in a campaign that names none; `variant_of` are the programs of the variant as the campaign names
    them. `trace` is the campaign's limit above which the run keeps traces (plan/trace.py), `UNTRACED` for the twin of
    such a run, and empty if no traces are asked for. `subject` is whose programs it measures.
    """

    name: str
    suite: str
    parameters: Mapping[str, suites.Value]
    condition: str = conditions.IDLE
    settings: Mapping[str, suites.Value] = field(default_factory=dict)
    repeat: int = 1
    seed: int | None = None
    variant: str = ""
    variant_of: tuple[str, ...] = ()
    kernel: KernelName | None = None
    trace: str = ""
    subject: Subject = SUITE_PROGRAMS

    @property
    def middleware(self) -> str:
        """The name of the middleware that it measures through."""
        return suites.middleware_of(self.suite, self.parameters)

    @property
    def least_s(self) -> float:
        """The least time that the measuring can take, in seconds: its timeouts or periods alone."""
        return self._measuring_s(0.0)

    @property
    def expected_s(self) -> float:
        """How long the measuring should take, in seconds."""
        return self._measuring_s(MEASUREMENT_COST_S)

    @property
    def period_ns(self) -> float | None:
        """The least time from one measurement to the next; None: it depends on the observed programs."""
        return suites.period_of(self.parameters)

    @property
    def settle_s(self) -> float:
        """How long the background programs are waited for before the suite starts, in seconds."""
        return conditions.settle_s(self.condition, self.settings)

    @property
    def start_and_end_s(self) -> float:
        """How long its programs should take to start and to end, in seconds."""
        return START_AND_END_S + (LOADS_S if conditions.conditions().conditions[self.condition].loads else 0.0)

    @property
    def total_s(self) -> float:
        """How long the run should take, with every wait, in seconds."""
        return self.expected_s + self.settle_s + self.start_and_end_s

    def _measuring_s(self, cost_s: float) -> float:
        """How long the measuring takes, in seconds; `cost_s` is added to each timeout, and is the shortest period."""
        if not isinstance(self.subject, SuitePrograms):
            return self.subject.for_s
        number = {key: value for key, value in self.parameters.items() if isinstance(value, int)}
        if "duration_s" in number:
            return float(number["duration_s"])
        if "timeout_us" in number:
            return number["repetitions"] * (number["timeout_us"] / 1e6 + cost_s)
        period_s = number["interval_us"] / 1e6 if "interval_us" in number else 1 / number["frequency_hz"]
        return number["repetitions"] * max(period_s, cost_s) + number.get("start_delay_s", 0)


def interleave(runs: Iterable[Run], seed: int) -> tuple[Run, ...]:
    """Order runs by repeat: an odd repeat in an order drawn with a seed, an even one in the reverse order of the repeat
    before. After each pair of repeats, all runs have the same mean starting time."""
    runs = list(runs)
    names = {(_measured(run), run.repeat): run.name for run in runs}
    # By a hash, so that a seed gives the same order with every version of Python.
    draw = {}
    for run in runs:
        name = names.get((_measured(run), run.repeat - (run.repeat % 2 == 0)), run.name)
        draw[run.name] = hashlib.sha256(f"{seed} {name}".encode()).digest()
    ordered: list[Run] = []
    for repeat, block in itertools.groupby(sorted(runs, key=lambda run: run.repeat), key=lambda run: run.repeat):
        ordered += sorted(block, key=lambda run: draw[run.name], reverse=repeat % 2 == 0)
    return tuple(replace(run, seed=seed) for run in ordered)


def _measured(run: Run) -> str:
    """A text that describes what a run measures, the same for all its repeats."""
    return repr(replace(run, name="", repeat=1, seed=None))


def order_by_kernel(runs: Sequence[Run], kernels: Sequence[KernelName]) -> tuple[Run, ...]:
    """Order runs by repeat, and those of one repeat by kernel; otherwise they keep their order.

    From one repeat to the next the order of the kernels is reversed (standard, rt, rt, standard): a steady drift of the
    target then moves the results of both by nearly the same. With less than two kernels nothing changes.
    """
    if len(kernels) < 2:
        return tuple(runs)
    numbers = {kernel: number for number, kernel in enumerate(kernels)}

    def place(run: Run) -> tuple[int, int]:
        number = numbers[run.kernel] if run.kernel else 0
        return run.repeat, number if run.repeat % 2 else -number

    return tuple(sorted(runs, key=place))


def blocks(runs: Sequence[Run], *, is_shared: bool = False) -> list[tuple[Run, ...]]:
    """The runs in their order, divided into blocks that are measured together, on one board and one boot.

    A block is one repeat on one kernel, so that differences between boots are not taken for an effect of the kernel.
    The runs of a campaign with less than two kernels are one block. If boards share a campaign (`is_shared`), a block
    is one repeat on all kernels, so that runs to compare are measured on the same board; a campaign of one repeat is
    shared out run by run.
    """
    if is_shared:
        by_repeat: dict[object, list[Run]] = {}
        # A run that keeps traces is compared with its twin, and takes its limit from its warm-up.
        is_whole = any(run.repeat > 1 or run.trace for run in runs)
        for run in runs:
            by_repeat.setdefault(run.repeat if is_whole else run.name, []).append(run)
        return [tuple(block) for block in by_repeat.values()]
    if len({run.kernel for run in runs}) < 2:
        return [tuple(runs)]
    return [tuple(block) for _, block in itertools.groupby(runs, key=lambda run: (run.repeat, run.kernel))]


def digest_of(runs: Sequence[Run]) -> str:
    """The digest of the canonical form of these runs, ``<version>:<SHA-256>``.

    The form of a run holds the fields that are not at their default, and the parameters and settings that are not at
    the default of their option. So a field or an option that is added later changes no digest.
    """
    forms = json.dumps([_canonical(run) for run in runs], sort_keys=True)
    return f"{DIGEST_VERSION}:{hashlib.sha256(forms.encode()).hexdigest()}"


def _canonical(run: Run) -> dict[str, Any]:
    form: dict[str, Any] = {}
    for attribute in fields(run):
        value = getattr(run, attribute.name)
        default = attribute.default_factory() if attribute.default_factory is not MISSING else attribute.default
        if value != default:
            name = run.subject.word if attribute.name == "subject" else attribute.name
            form[name] = dict(value) if isinstance(value, Mapping) else _plain(value)
    form["parameters"] = _without_defaults(run.parameters, suites.defaults_of(run.suite))
    settings = {key: option.default for key, option in conditions.conditions().settings.items()}
    form["settings"] = _without_defaults(run.settings, settings)
    return form


def _plain(value: Any) -> Any:
    """A value in the form of JSON, without fields at their default."""
    if is_dataclass(value) and not isinstance(value, type):
        set_ = (attribute for attribute in fields(value) if getattr(value, attribute.name) != attribute.default)
        return {attribute.name: _plain(getattr(value, attribute.name)) for attribute in set_}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _without_defaults(values: Mapping[str, suites.Value], defaults: Mapping[str, suites.Value]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in defaults or value != defaults[key]}


def idle_twice(run: Run) -> str | None:
    """Why the idle states of a run would not be as it asks for, or None."""
    state, awake_us = (run.parameters.get(key) for key in ("deepest_idle_state", "cpu_dma_latency_us"))
    if state is None or awake_us is None:
        return None
    return (
        f"deepest_idle_state {state} would change nothing while cpu_dma_latency_us {awake_us} keeps all idle CPUs "
        "awake: give cpu_dma_latency_us: null"
    )


def never_observed(run: Run) -> str | None:
    """Say why a run can never be valid: the sampler does not observe it, or the run ends too early; None: it can."""
    suite = suites.suite(run.suite)
    observed = {key: value for key, value in run.settings.items() if value and key in conditions.conditions().pinned}
    if conditions.conditions().conditions[run.condition].loads:
        observed["condition"] = run.condition
    # A suite writes down its own policy and CPUs, a baseline does not.
    if suite.is_baseline:
        keys = ("cpu", "policy")
        observed |= {key: value for key in keys if (value := run.parameters.get(key)) not in (None, "", "0")}
    if not observed:
        return None
    what = ", ".join(f"{key} {value}" for key, value in observed.items())
    if run.settings.get(conditions.SAMPLER):
        return f"{what} must be observed: sampler none is for runs without it"
    if run.least_s >= conditions.FIRST_OBSERVATION_S:
        return None
    return (
        f"{run.suite} measures {run.least_s:.3g} s, but {what} must be observed, for which it must measure "
        f"{conditions.FIRST_OBSERVATION_S:g} s at least"
    )


def label(run: Run) -> str:
    """The part of a run's name that distinguishes it from others of its campaign."""
    subscribers = run.parameters.get("subscribers")
    words = [suites.output_name(run.suite, run.parameters), *([f"{subscribers}sub"] if subscribers else [])]
    if isinstance(run.subject, TopologyPlan):
        words += [run.subject.topology.name, *str(run.parameters.get(OTHER_NODES) or "").split()]
    words += [run.middleware] if run.middleware != suites.suite(run.suite).middleware else []
    words += [run.condition] if run.condition != conditions.IDLE else []
    settings = conditions.conditions().settings
    words += [f"{key}{value}" for key, value in run.settings.items() if value != settings[key].default]
    words += [word for word in (run.variant, run.kernel, f"trace-{run.trace}" if run.trace else "") if word]
    return "-".join([*words, *([f"r{run.repeat}"] if run.repeat > 1 else [])])
