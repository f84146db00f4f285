"""Years of daily gates and courses without a change, simulated: how often is there an alarm, how often is it right?

Each day is a boot with two runs. Boots differ by 2 % (standard deviation), the runs of a boot by 1 % more. Of misses
a boot has a number that varies from boot to boot by more than chance.

PYTHONPATH=tests .venv/bin/python tests/coverage/years.py [--only drifting]
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs_table import write_rows
from rtrun.analysis import history
from rtrun.analysis.change_points import find_changes, means_of_units

DOCS = Path(__file__).parents[2] / "docs" / "archive.md"
BEGIN = "<!-- make coverage writes from here -->"
SEED = 20140715
DRAWS = 200  # of each row
HEAD = f"""\
Seed {SEED} for each row.

| what | share | allowed | draws |
|---|---:|---:|---:|"""

Floats = NDArray[np.float64]
Rng = np.random.Generator
FALSE_ALARMS = 0.05
BEFORE = 30  # days that are in the archive when the year of gates begins
OF_BOOTS, OF_RUNS = 0.02, 0.01
MEASUREMENTS = 100_000  # of a boot


def normal(rng: Rng, n: int) -> Floats:
    """Normal differences of boots."""
    return rng.normal(size=n)


def skewed(rng: Rng, n: int) -> Floats:
    """Gumbel's distribution, as of a highest value: skewness 1.1."""
    return (rng.gumbel(size=n) - np.euler_gamma) * np.sqrt(6) / np.pi


def heavy(rng: Rng, n: int) -> Floats:
    """Student's t with five degrees of freedom: outliers on both sides."""
    return rng.standard_t(5, size=n) * np.sqrt(3 / 5)


def weekly(rng: Rng, n: int) -> Floats:
    """Half of the variance is a wave of seven days."""
    return np.sin(np.arange(n) * 2 * np.pi / 7) + np.sqrt(0.5) * rng.normal(size=n)


def two_kinds(rng: Rng, n: int) -> Floats:
    """One boot in five is of a slower kind, by two standard deviations."""
    kinds = (rng.random(n) < 0.2) - 0.2
    return 2 * kinds + np.sqrt(0.36) * rng.normal(size=n)


def drifting(rng: Rng, n: int) -> Floats:
    """Each boot is seven tenths of the one before and something new: it goes up and down over weeks."""
    new = rng.normal(size=n + 20) * np.sqrt(1 - 0.7**2)
    levels = np.zeros(n + 20)
    for k in range(1, n + 20):
        levels[k] = 0.7 * levels[k - 1] + new[k]
    return levels[20:]


def days(rng: Rng, boots: Callable[[Rng, int], Floats], n: int) -> tuple[Floats, list[str]]:
    """The figure of each run of n days, and the boot of each run."""
    levels = 1 + OF_BOOTS * boots(rng, n)
    runs = np.repeat(levels, 2) + OF_RUNS * rng.normal(size=2 * n)
    return 100 * runs, [str(k // 2) for k in range(2 * n)]


def alarm_in_a_year(
    rng: Rng, *, boots: Callable[[Rng, int], Floats], year: int = 365, margin: float = 0.0, slower: float = 0.0
) -> bool:
    """Whether any of a year's daily gates fails a build that is slower by `slower` percent, with a margin in percent.

    Two spreads of a boot, the least margin, are 4.5 % here.
    """
    runs, units = days(rng, boots, BEFORE + year)
    values = means_of_units(runs, units)
    values[BEFORE:] += slower
    level = history.level_of_test(FALSE_ALARMS, 1)
    return any(
        history.compare_figure(values[:day], values[day : day + 1], margin=margin, level=level).worse
        for day in range(BEFORE, BEFORE + year)
    )


def misses_of_boots(rng: Rng, mean: float, n: int) -> list[tuple[int, int]]:
    """(measurements, misses) of n boots, so many misses a boot on average; the rate of a boot varies by a half."""
    return [(MEASUREMENTS, int(misses)) for misses in rng.poisson(mean * rng.gamma(4, 1 / 4, n))]


def miss_alarm_in_a_year(rng: Rng, *, mean: float) -> bool:
    """Whether any of a year's daily gates fails a build for its misses, though nothing changes.

    The condition that takes little time is asked first: `compare_misses` needs both.
    """
    boots = misses_of_boots(rng, mean, BEFORE + 365)
    level = history.level_of_test(FALSE_ALARMS, 1)
    gates = ((boots[:day], boots[day : day + 1]) for day in range(BEFORE, BEFORE + 365))
    return any(
        history.chance_of_misses(old, new) < level and history.compare_misses(old, new, level=level).worse
        for old, new in gates
    )


def build_that_misses_fails(rng: Rng, *, mean: float, times: float) -> bool:
    """Whether a build of one boot that misses so many times as often fails against 90 boots."""
    level = history.level_of_test(FALSE_ALARMS, 4)
    old, new = misses_of_boots(rng, mean, 90), misses_of_boots(rng, mean * times, 1)
    return history.compare_misses(old, new, level=level).worse


def change_seen(rng: Rng, *, boots: Callable[[Rng, int], Floats], n: int = 120) -> bool:
    """Whether a course of n boots without a change shows one."""
    return bool(find_changes(means_of_units(*days(rng, boots, n))))


def worse_build_fails(rng: Rng, *, shift: float, boots: int, margin: float = 5.0) -> bool:
    """Whether a build that is slower by a shift in percent fails against 90 boots, with a margin of 5 %."""
    runs, units = days(rng, normal, 90 + boots)
    values = means_of_units(runs, units)
    values[90:] += shift
    level = history.level_of_test(FALSE_ALARMS, 4)  # of the four figures of a scenario
    return history.compare_figure(values[:90], values[90:], margin=margin, level=level).worse


def change_found(rng: Rng, *, shift: float, after: int = 10) -> bool:
    """Whether a change by a shift in percent is seen when so many boots came after it, 60 before."""
    runs, units = days(rng, normal, 60 + after)
    values = means_of_units(runs, units)
    values[60:] += shift
    return any(abs(change.index - 60) <= 2 for change in find_changes(values))


@dataclass(frozen=True, kw_only=True)
class Row:
    """An event whose share over many draws must be at most or at least so many percent."""

    name: str
    draw: Callable[[Rng], bool]
    at_most: float = 100.0
    at_least: float = 0.0


_YEAR = "any false alarm in a year of daily gates"
# 5 %, and two standard errors of the draws, in percent.
_FIVE_PERCENT = float(round(5 + 200 * np.sqrt(0.05 * 0.95 / DRAWS)))


ROWS = (
    *(
        Row(
            name=f"{_YEAR}, boots {kind.__name__}, no margin given",
            draw=partial(alarm_in_a_year, boots=kind),
            at_most=_FIVE_PERCENT,
        )
        for kind in (normal, skewed, weekly, two_kinds, heavy, drifting)
    ),
    *(
        Row(
            name=f"{_YEAR}, boots {kind.__name__}, margin 10 %, builds slower by {slower:g} %",
            draw=partial(alarm_in_a_year, boots=kind, margin=10.0, slower=slower),
            at_most=_FIVE_PERCENT,
        )
        for kind, slower in ((skewed, 3.0), (drifting, 3.0), (normal, 10.0))
    ),
    *(
        Row(
            name=f"{_YEAR}, P(miss), {mean:g} misses a boot",
            draw=partial(miss_alarm_in_a_year, mean=mean),
            at_most=_FIVE_PERCENT,
        )
        for mean in (0.05, 3.0)
    ),
    *(
        Row(name=f"a change in 120 boots without one, boots {kind.__name__}", draw=partial(change_seen, boots=kind),
            at_most=100.0 if kind is drifting else _FIVE_PERCENT)
        for kind in (normal, skewed, two_kinds, heavy, drifting)
    ),
    *(
        Row(
            name=f"a build slower by {shift:g} % fails, {boots} boot{'s' * (boots > 1)}, margin 5 %",
            draw=partial(worse_build_fails, shift=shift, boots=boots),
            at_least=least,
        )
        for shift, boots, least in ((10, 1, 0), (15, 1, 50), (20, 1, 95), (10, 3, 0), (15, 3, 95))
    ),
    *(
        Row(
            name=f"a build that misses {times:g} times as often fails, {mean:g} misses a boot before",
            draw=partial(build_that_misses_fails, mean=mean, times=times),
            at_least=least,
        )
        for mean, times, least in ((0.05, 300, 85), (3, 20, 85))
    ),
    *(
        Row(name=f"a change by {shift:g} % is seen after 10 boots", draw=partial(change_found, shift=shift),
            at_least=least)
        for shift, least in ((2, 0), (4, 80), (6, 95))
    ),
)  # fmt: skip


def bound_of(row: Row) -> str:
    """What the share of a row is held to."""
    if row.at_most < 100:
        return f"at most {row.at_most:g} %"
    return f"at least {row.at_least:g} %" if row.at_least else "-"


def main() -> int:
    """Simulate, print and write each row. Exit 1 when a share is beyond its bound."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows with this in their name; the others of the table stay")
    args = parser.parse_args()
    failed = 0
    for row in ROWS:
        if args.only not in row.name:
            continue
        start, rng = time.monotonic(), np.random.default_rng(SEED)
        share = 100 * sum(row.draw(rng) for _ in range(DRAWS)) / DRAWS
        holds = row.at_least <= share <= row.at_most
        failed += not holds
        line = f"| {row.name} | {share:.1f} % | {bound_of(row)} | {DRAWS} |"
        write_rows(DOCS, BEGIN, HEAD, [line], [row.name for row in ROWS])
        print(f"{'ok    ' if holds else 'FAILED'} {line} in {time.monotonic() - start:.0f} s", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
