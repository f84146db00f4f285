"""The hazards of a machine: each draws its sizes and writes them into a plan. Two that take the same slot exclude one
another."""

import functools
import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from drawn.factors import (
    Beat,
    Climb,
    DayAndNight,
    Edge,
    Factor,
    Leak,
    OfLoops,
    Ramp,
    Rng,
    SlowLoad,
    Step,
    TwoKinds,
    Unlike,
)

RUNS_MAX, BOOTS_MAX, BOARDS_MAX = 40, 20, 10


@dataclass(kw_only=True)
class Failing:
    """Attempts that end badly, the likelier the later they are, and what becomes of them."""

    of_bad: float
    of_good: float
    how: str
    """failed, incomplete or invalid: as the runner keeps them; or deleted, missing: what the user makes of them."""


@dataclass(kw_only=True)
class Plan:
    """A machine, and how it is measured, as far as it is drawn. `loops` are those of all runs together."""

    probability: float
    loops: int
    boards: int
    boots: int
    runs: int
    suite: str = ""
    base: str = "independent"
    burst: float = 1.0
    is_burst_fixed: bool = False
    rho: float = 0.0
    tail: str = "tail"
    tail_index: float = 0.5
    factors: list[Factor] = field(default_factory=list)
    threads: int = 1
    ratio: float = 1.0
    """Of the longest boot to the shortest."""
    nights: bool = False
    failing: Failing | None = None
    gaps: float = 0.0
    """The share of the time of the load in which nothing is seen."""
    copies: int = 0
    is_boot_known: bool = True
    looks: bool = False

    @property
    def is_independent(self) -> bool:
        """Whether one miss tells nothing of the next one, within a run and from run to run, but for units unlike."""
        return self.base == "independent" and not any(isinstance(each, OfLoops) for each in self.factors)

    @property
    def run_loops(self) -> int:
        """About so many loops has a run."""
        return max(30, self.loops // self.runs)


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _bursts(plan: Plan, rng: Rng) -> None:
    plan.base, plan.burst = "bursts", float(rng.choice([2, 3, 5, 10, 20]))
    plan.is_burst_fixed = bool(rng.random() < 0.5)


def _ar(plan: Plan, rng: Rng) -> None:
    plan.base, plan.rho = "ar", float(rng.choice([0.5, 0.8, 0.9, 0.95, 0.99]))


def _slow_load(plan: Plan, rng: Rng) -> None:
    mean = plan.run_loops * _log_uniform(rng, 0.05, 2)
    plan.factors.append(SlowLoad(float(rng.uniform(0.05, 0.5)), float(rng.uniform(0.7, 1)), mean))


def _beat(plan: Plan, rng: Rng) -> None:
    period = _log_uniform(rng, 3, max(4.0, plan.run_loops / 3))
    share = max(1 / period, 5 * plan.probability, _log_uniform(rng, 0.02, 0.3))
    plan.factors.append(Beat(period, min(share, 0.5), float(rng.uniform(0.7, 1))))


def _edge(is_end: bool) -> Callable[[Plan, Rng], None]:
    def apply(plan: Plan, rng: Rng) -> None:
        least = max(5.0, 5 * plan.probability * plan.run_loops)
        loops = _log_uniform(rng, least, max(least + 1, min(500, plan.run_loops / 3)))
        plan.factors.append(Edge(loops, float(rng.uniform(0.3, 0.95)), is_end))

    return apply


def _leak(plan: Plan, rng: Rng) -> None:
    plan.factors.append(Leak(_log_uniform(rng, 1, 40)))


def _ramp(plan: Plan, rng: Rng) -> None:
    plan.factors.append(Ramp(_log_uniform(rng, 1, 40)))


def _climb(plan: Plan, rng: Rng) -> None:
    plan.boots = max(plan.boots, int(rng.integers(4, BOOTS_MAX + 1)))
    plan.factors.append(Climb(_log_uniform(rng, 1, 40)))


def _step(plan: Plan, rng: Rng) -> None:
    plan.runs = max(plan.runs, 4)
    before = _log_uniform(rng, 0.01, 0.3) if rng.random() < 0.75 else _log_uniform(rng, 3, 20)
    plan.factors.append(Step(float(rng.uniform(0.3, 0.9)), before))


def _day_and_night(plan: Plan, rng: Rng) -> None:
    plan.nights, plan.runs = True, max(plan.runs, 3)
    plan.factors.append(DayAndNight(float(rng.uniform(0.7, 1))))


def _unlike(level: str) -> Callable[[Plan, Rng], None]:
    def apply(plan: Plan, rng: Rng) -> None:
        plan.factors.append(Unlike(level, float(rng.uniform(0.3, 1.0))))

    return apply


def _two_kinds(level: str, low: float, high: float) -> Callable[[Plan, Rng], None]:
    def apply(plan: Plan, rng: Rng) -> None:
        share = max(_log_uniform(rng, low, high), 1.2 * plan.probability)
        plan.factors.append(TwoKinds(level, share, float(rng.uniform(0.6, 1))))

    return apply


def _boards(then: Callable[[Plan, Rng], None]) -> Callable[[Plan, Rng], None]:
    def apply(plan: Plan, rng: Rng) -> None:
        plan.boards = int(rng.integers(2, BOARDS_MAX + 1))
        then(plan, rng)

    return apply


def _heavy_tails(plan: Plan, rng: Rng) -> None:
    plan.tail, plan.tail_index = "heavy", float(rng.uniform(0.3, 1.5))


def _unequal_lengths(plan: Plan, rng: Rng) -> None:
    plan.ratio = _log_uniform(rng, 5, 1000)
    plan.boots = max(plan.boots, 3)


def _failing(*ways: str) -> Callable[[Plan, Rng], None]:
    def apply(plan: Plan, rng: Rng) -> None:
        share = max(_log_uniform(rng, 0.03, 0.4), 1.2 * plan.probability)
        plan.factors.append(TwoKinds("run", share, float(rng.uniform(0.6, 1))))
        plan.failing = Failing(
            of_bad=float(rng.uniform(0.6, 1)), of_good=float(rng.choice([0.0, 0.05])), how=str(rng.choice(ways))
        )

    return apply


def _missed_rates(plan: Plan, rng: Rng) -> None:
    _failing("invalid")(plan, rng)
    plan.suite = "messages"


def _gaps(plan: Plan, rng: Rng) -> None:
    # Up to nearly all of the time.
    mean = plan.run_loops * _log_uniform(rng, 0.05, 2)
    plan.factors.append(SlowLoad(float(rng.uniform(0.05, 0.95)), 1 - 0.05 * float(rng.random()), mean))
    plan.suite, plan.gaps = "observed", float(rng.uniform(0.5, 1))
    plan.runs = min(plan.runs, 20)


def _histograms(plan: Plan, rng: Rng) -> None:
    plan.suite, plan.runs = "histograms", min(plan.runs, 12)
    plan.boots = min(plan.boots, plan.runs)


def _threads(plan: Plan, rng: Rng) -> None:
    plan.threads = int(rng.choice([2, 4, 8]))
    if not plan.suite:
        plan.suite = str(rng.choice(["messages", "histograms"]))
    plan.runs = min(plan.runs, 12)
    plan.boots = min(plan.boots, plan.runs)


def _copies(plan: Plan, rng: Rng) -> None:
    plan.copies = int(rng.integers(1, 4))
    if not plan.suite and rng.random() < 0.6:
        _histograms(plan, rng)


def _unknown_boots(plan: Plan, rng: Rng) -> None:
    plan.is_boot_known = False
    plan.boots = int(rng.integers(1, 3))
    plan.runs = max(plan.runs, 2)
    plan.factors.append(Unlike("boot", float(rng.uniform(0.3, 1.0))))


def _looks(plan: Plan, rng: Rng) -> None:
    plan.looks, plan.runs = True, max(plan.runs, 4)


@dataclass(frozen=True, kw_only=True)
class Hazard:
    """`slots` are what no other hazard of the machine may take. An answer that names it matches `caveat`, with a number
    in the same sentence. `is_structural`: it stands in the files, whatever was measured."""

    apply: Callable[[Plan, Rng], None]
    slots: frozenset[str]
    caveat: str
    is_structural: bool = False


def _hazard(apply: Callable[[Plan, Rng], None], slots: str, caveat: str, *, structural: bool = False) -> Hazard:
    return Hazard(apply=apply, slots=frozenset(slots.split()), caveat=caveat, is_structural=structural)


# In the order in which they are applied: what chooses the suite comes before what looks at it.
HAZARDS = {
    "histograms": _hazard(_histograms, "suite files", "order|histogram"),
    "gaps": _hazard(_gaps, "suite files slow threads copies", "seen|gap|covers?", structural=True),
    "missed rates": _hazard(_missed_rates, "suite failing run files", "rate", structural=True),
    "threads": _hazard(_threads, "threads", "thread|subscriber|at once|same moment|same event"),
    "copies": _hazard(_copies, "copies", "cop(y|ies)|twice|same (counts|histogram|samples)", structural=True),
    "bursts": _hazard(_bursts, "base", "burst|episode|stall"),
    "AR": _hazard(_ar, "base", "burst|episode|depend"),
    "slow load": _hazard(_slow_load, "slow", "load|slow|comes? back"),
    "ramp": _hazard(_ramp, "trend", "trend|climb|rise|change|drift"),
    "start of a run": _hazard(_edge(False), "edge", "start-up|first [0-9 ]+ (loops|values)|left out"),
    "end of a run": _hazard(_edge(True), "edge", "\\bend\\b|last [0-9 ]+ (loops|values)|left out"),
    "beat": _hazard(_beat, "beat", "beat|every [0-9]|period"),
    "day and night": _hazard(_day_and_night, "hour", "hours? of the day|o'clock|night|by day"),
    "leak": _hazard(_leak, "trend", "trend|climb|rise|leak|within (a|each) run|longer"),
    "climb": _hazard(_climb, "trend", "trend|climb|rise|from boot to boot|order of the boots"),
    "step": _hazard(_step, "trend", "step|change|trend"),
    "rare states": _hazard(_two_kinds("run", 0.02, 0.2), "run", "(runs|states) of another kind|rare|unlike"),
    "unlike runs": _hazard(_unlike("run"), "run", "(runs|states) of another kind|runs differ|from run to run|unlike"),
    "bad boots": _hazard(_two_kinds("boot", 0.02, 0.3), "boot", "boots of another kind|boots unlike|other boots"),
    "unlike boots": _hazard(_unlike("boot"), "boot", "boots of another kind|boots unlike|boots differ"),
    "bad boards": _hazard(
        _boards(_two_kinds("board", 0.05, 0.3)), "board", "boards of (this|another) kind|boards unlike"
    ),
    "unlike boards": _hazard(
        _boards(_unlike("board")), "board", "boards of (this|another) kind|boards (unlike|differ)"
    ),
    "heavy tails": _hazard(_heavy_tails, "tail", "tail"),
    "unequal lengths": _hazard(_unequal_lengths, "length", "longest|length|one boot"),
    "failures": _hazard(_failing("failed"), "failing run files", "fail|attempt|measured again", structural=True),
    "hangs": _hazard(
        _failing("incomplete"), "failing run files", "cut off|incomplete|attempt|hang|hung", structural=True
    ),
    "deletes": _hazard(_failing("deleted", "missing"), "failing run files", "missing|deleted|attempt", structural=True),
    "unknown boots": _hazard(_unknown_boots, "boot known", "boot.*unknown|unknown.*boot", structural=True),
    "looks": _hazard(_looks, "user", "look"),
}
INDEPENDENT = "independent misses"
# What the question is about where that is more, or other, than what was measured.
POPULATIONS = {
    "gaps": "all of the time, seen or not",
    "missed rates": "all attempts at a run",
    "failures": "all attempts at a run",
    "hangs": "all attempts at a run",
    "deletes": "all attempts at a run",
    "day and night": "all hours of the day",
    "leak": "a process that lives a quarter longer, after what was measured",
    "ramp": "a twentieth of the time measured, after it",
    "climb": "the next boot",
    "step": "the machine since the step",
    "rare states": "runs of all kinds",
    "unlike runs": "runs of all kinds",
    "bad boots": "boots of all kinds, which count alike",
    "unlike boots": "boots of all kinds, which count alike",
    "unknown boots": "boots of all kinds, which count alike",
    "bad boards": "boards of all kinds, which count alike",
    "unlike boards": "boards of all kinds, which count alike",
    "unequal lengths": "runs that count alike, or for as long as they are",
}
_NUMBER = re.compile("[0-9]")


# So often comes each hazard alone where each pair comes once, and so many of these are three.
ALONE, THREE = 4, 30


@functools.cache
def combinations() -> tuple[tuple[str, ...] | None, ...]:
    """The hazards of one seed after the other: each alone, each pair that can be; None for three that are drawn."""
    pairs = [pair for pair in itertools.combinations(HAZARDS, 2) if _go_together(pair)]
    alone = [(), *((name,) for name in HAZARDS)]
    return (*alone * ALONE, *pairs, *[None] * THREE)


def _go_together(names: Sequence[str]) -> bool:
    slots = [slot for name in names for slot in HAZARDS[name].slots]
    return len(slots) == len(set(slots))


def hazards_of(seed: int) -> tuple[str, ...]:
    """The hazards of a machine, in their order."""
    # A step that shares no factor with the number of combinations: a short run has some of everything, too.
    known = combinations()
    step = next(each for each in range(int(0.618 * len(known)), len(known)) if math.gcd(each, len(known)) == 1)
    chosen = known[seed * step % len(known)]
    if chosen is not None:
        return chosen
    rng = np.random.default_rng([seed, 2])
    names = list(HAZARDS)
    while not _go_together(three := sorted(rng.choice(names, 3, replace=False), key=names.index)):
        pass
    return tuple(map(str, three))


def draw_plan(rng: Rng, hazards: tuple[str, ...]) -> Plan:
    """Draw the sizes of a machine with these hazards."""
    probability = float(rng.choice([1e-2, 3e-3, 1e-3], p=[0.7, 0.2, 0.1]))
    runs = min(RUNS_MAX, int(_log_uniform(rng, 1, RUNS_MAX + 1)))
    plan = Plan(
        probability=probability,
        loops=int(_log_uniform(rng, 4, 50) / probability),
        boards=1 if rng.random() < 0.85 else int(rng.integers(2, 5)),
        boots=int(rng.integers(1, min(runs, BOOTS_MAX) + 1)),
        runs=runs,
        tail=str(rng.choice(["tail", "mixture"])),
    )
    for name in hazards:
        HAZARDS[name].apply(plan, rng)
    if plan.failing and plan.suite == "histograms":
        # Of a cyclictest that failed there is nothing to import.
        plan.suite = "messages"
    plan.suite = plan.suite or str(rng.choice(["oneshot", "cyclic", "messages"]))
    plan.boots = min(max(plan.boots, plan.boards), BOOTS_MAX)
    plan.runs = max(plan.runs, plan.boots)
    return plan


def named_in(text: str) -> list[str]:
    """The hazards that an answer names with a number."""
    sentences = [part for part in re.split("[;.] |\n", text) if _NUMBER.search(part)]
    return [name for name, hazard in HAZARDS.items() if any(re.search(hazard.caveat, part) for part in sentences)]


def lengths(plan: Plan, rng: Rng) -> np.ndarray:
    """The loops of each run: equal, but for boots that were measured for longer."""
    boots = np.arange(plan.runs) * plan.boots // plan.runs
    weight = np.ones(plan.boots)
    if plan.ratio > 1:
        if rng.random() < 0.5:
            weight[rng.integers(plan.boots)] = plan.ratio
        else:
            weight = np.exp(rng.uniform(0, math.log(plan.ratio), plan.boots))
    each = weight[boots] / weight.min()
    least = max(40.0, min(plan.loops / each.sum(), 200_000 / each.sum()))
    return np.minimum(least * each, 120_000).astype(int)
