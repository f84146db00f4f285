"""What is simulated: how often a verdict is wrong, a row for every kind of data, with the share that is allowed.

P(miss) is the target itself, but for a millionth part, so that every PROVEN is one too many. Data are not chosen to
suit the method: nothing in a sample but the misses hints at bursts, boots or a change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import null_campaigns
import numpy as np
import processes
from processes import DEADLINE_NS, Int64s, Rng

from rtrun.analysis.deadline import Answer, Verdict, judge
from rtrun.analysis.histogram import from_samples
from rtrun.analysis.intervals import clopper_pearson
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram

SEED = 20140715
P = 1e-3
Draw = Callable[[Rng], bool | None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A kind of data, and an event whose share over many draws must be at most (at least) so much, in percent.

    A draw is True where the event happened, None where it does not count. ``today`` is the share before these remedies
    as it was reported, ``remedy`` the function of rtrun.analysis.deadline without which the quick bound must fail, and
    what stands in for it.
    """

    name: str
    event: str
    draw: Draw
    at_most: float = 100.0
    at_least: float = 0.0
    quick: int = 120
    long: int = 2000
    reported: str = ""
    remedy: tuple[str, object] | None = None

    def events(self, draws: int, part: int = 0) -> tuple[int, int]:
        """In how many of so many draws the event happened, and how many of them count; each part has its own seed."""
        rng = np.random.default_rng([SEED, part])
        counted = [happened for _ in range(draws) if (happened := self.draw(rng)) is not None]
        return sum(counted), len(counted)

    def holds(self, share: float) -> bool:
        """Whether a share is within the bounds."""
        return self.at_least <= share <= self.at_most


def percent(events: int, counted: int) -> float:
    """The share of events among the draws that count."""
    return 100 * events / max(1, counted)


def trials_of(values: Int64s, number: int, boot: str) -> Trials:
    return replace(count_misses(values, DEADLINE_NS), run=str(number), boot=boot, start_time=f"{number:04d}")


def judged(trials: Sequence[Trials]) -> Verdict:
    return judge(trials, deadline_ns=DEADLINE_NS, probability=P * (1 - 1e-6), confidence=0.95)


def verdict_on(runs: Sequence[Int64s], *, one_boot: bool = True) -> Verdict:
    """The verdict on runs of one boot, or of a boot each."""
    return judged([trials_of(values, k, "boot" if one_boot else str(k)) for k, values in enumerate(runs)])


def proven(make: Callable[[Rng], Int64s], rng: Rng) -> bool:
    return verdict_on([make(rng)]).answer == Answer.PROVEN


def proven_of_boots(number: int, n: int, rng: Rng) -> bool:
    runs = processes.boots(number, n, P, rng, spread=0.5)
    return verdict_on(runs, one_boot=False).answer == Answer.PROVEN


def proven_for(length: float, n: int, rng: Rng) -> bool:
    """PROVEN, and said to hold for bursts of this length."""
    verdict = verdict_on([processes.bursts(n, P, rng, length=length)])
    return verdict.answer == Answer.PROVEN and verdict.longest_burst >= length


def proven_at_any_look(looks: int, n: int, rng: Rng) -> bool:
    """PROVEN after any of so many batches."""
    batches: list[Trials] = []
    for look in range(looks):
        batches.append(trials_of(processes.independent(n, P, rng), look, "boot"))
        if judged(batches).answer == Answer.PROVEN:
            return True
    return False


def proven_without_order(rng: Rng) -> bool:
    histogram = from_samples(processes.bursts(20_000, P, rng, length=5))
    trials = [count_misses_in_histogram(histogram, DEADLINE_NS)]
    return judge(trials, deadline_ns=DEADLINE_NS, probability=P, confidence=0.95).answer == Answer.PROVEN


def enough(process: processes.Process, rate: float, rng: Rng) -> bool | None:
    """Whether the number said to be likely enough was; None where none was said, or one too long to simulate."""
    n = 20_000
    first = process(n, rate, rng)
    further_likely = verdict_on([first]).further_likely
    if further_likely is None or further_likely[0] != Answer.PROVEN or further_likely[1] > 400_000:
        return None
    whole = process(n + further_likely[1], rate, rng)
    whole[:n] = first
    return verdict_on([whole]).answer == Answer.PROVEN


def _never_between(*_: object) -> float:
    return 0.0


ROWS = [
    *(
        Row(
            name=f"{name}, n = {n:.0e}",
            event="PROVEN",
            draw=partial(proven, partial(process, n, P)),
            at_most=5.0,
            quick=60 if n == 20_000 or name == "AR(0.95)" else 0,
            remedy=("_widened", lambda *_: 1.0) if name == "AR(0.95)" and n == 100_000 else None,
        )
        for name, process in processes.DEPENDENT.items()
        for n in (20_000, 100_000)
    ),
    *(
        Row(
            name=f"{number} boots, a run each, rates lognormal (sd 0.5), n = {n:.0e}",
            event="PROVEN",
            draw=partial(proven_of_boots, number, n),
            at_most=7.0 if number < 5 else 5.0,
            quick=60 if n == 200_000 else 0,
            reported={2: "38", 3: "36", 5: "30", 7: "26"}.get(number, ""),
            remedy=("_effect_between", _never_between) if n == 200_000 and number == 2 else None,
        )
        for number in (2, 3, 4, 5, 7, 10)
        for n in (20_000, 200_000)
    ),
    Row(
        name="bursts of 5, n = 1e4 (none seen: 13.5 %)",
        event="PROVEN",
        draw=partial(proven, partial(processes.bursts, 10_000, P, length=5.0)),
        reported="25",
        quick=0,
    ),
    Row(
        name="bursts of 5, n = 2e4 (none seen: 1.8 %)",
        event="PROVEN",
        draw=partial(proven, partial(processes.bursts, 20_000, P, length=5.0)),
        at_most=12.0,
        quick=100,
        remedy=("effect_of_few", lambda *_: 1.0),
    ),
    Row(
        name="bursts of 5, n = 5e4",
        event="PROVEN",
        draw=partial(proven, partial(processes.bursts, 50_000, P, length=5.0)),
        at_most=5.0,
        quick=60,
    ),
    *(
        Row(
            name=f"bursts of {length}, n = {n:.0e}",
            event=f"PROVEN and said to hold for bursts of {length}",
            draw=partial(proven_for, length, n),
            at_most=5.0,
            reported="80" if length >= 20 else "25",
            quick=80 if n == 20_000 else 0,
        )
        for length in (5, 20, 50)
        for n in (10_000, 20_000, 100_000)
    ),
    *(
        Row(
            name=f"looking after each of {looks} batches of 2000",
            event="PROVEN at any look",
            draw=partial(proven_at_any_look, looks, 2000),
            at_most=5.0,
            quick={20: 60}.get(looks, 0),
            long=2000 if looks < 100 else 1000,
            reported={1: "2", 5: "6", 20: "10", 100: "17"}[looks],
            remedy=("anytime_interval", clopper_pearson) if looks == 20 else None,
        )
        for looks in (1, 5, 20, 100)
    ),
    *(
        Row(
            name=f"P = 5e-3 in the last 5 % only, n = {n:.0e}{note}",
            event="PROVEN",
            draw=partial(proven, partial(processes.late_regime, n, p=5e-3, part=0.05)),
            at_most=at_most,
            quick=100 if n == 20_000 else 0,
            reported="32" if n == 10_000 else "",
        )
        for n, at_most, note in (
            (10_000, 100.0, " (at most one miss: 28.7 %)"),
            (20_000, 8.0, " (at most one miss: 4.0 %)"),
            (100_000, 1.0, ""),
        )
    ),
    Row(
        name="values rise by half during the run, n = 1e5, no miss yet",
        event="PROVEN",
        draw=partial(proven, partial(processes.rising, 100_000)),
        at_most=5.0,
        quick=60,
        remedy=("_strongest_change", lambda _: None),
    ),
    Row(
        name="a histogram without order, bursts of 5",
        event="PROVEN",
        draw=proven_without_order,
        at_most=0.0,
        quick=20,
        long=500,
    ),
    *(
        Row(
            name=f'"N more" in nine cases of ten, {name}, P(miss) = {rate / P:g} of the target',
            event="enough",
            draw=partial(enough, processes.DEPENDENT[name], rate),
            at_least=90.0,
            quick=0,
            long=draws,
            reported="11" if name == "AR(0.9)" else "",
        )
        for name, rate, draws in (("independent", P / 2, 1000), ("AR(0.5)", P / 2, 2000), ("AR(0.9)", P / 5, 6000))
    ),
    Row(
        name="independent, P(miss) a tenth of the target, n = 1e4",
        event="PROVEN",
        draw=partial(proven, partial(processes.independent, 10_000, P / 10)),
        at_least=80.0,
        quick=60,
    ),
    Row(
        # Seven claims can be decided wrongly, each at the level of 5 %.
        name="ten groups that differ in nothing, five runs each (claims)",
        event="a claim of the thesis is decided wrongly",
        draw=lambda rng: bool(null_campaigns.decided(rng)),
        at_most=30.0,
        quick=0,
        long=200,
        reported="70 to 90",
    ),
]
