"""Years of daily gates and courses without a change, simulated: how often is there an alarm, how often is it right?

Each day is a boot with two runs. Boots differ by 2 % (standard deviation), the runs of a boot by 1 % more. Of misses
a boot has a number that varies from boot to boot by more than chance.

PYTHONPATH=runner:tests .venv/bin/python tests/coverage/years.py [--only drifting]
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum, auto
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from docs_table import share_text, write_rows
from rtrun.analysis.comparison import history
from rtrun.analysis.order.change_points import find_changes, means_of_units

DOCS = Path(__file__).parents[2] / "docs" / "archive.md"
BEGIN = "<!-- make coverage writes from here -->"
SEED = 20140715
DRAWS = 200  # of each row but those of whole years of figures
DRAWS_OF_YEARS = 100
HEAD = f"""\
Seed {SEED} for each row; shares with their 95 % intervals.

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


def rare_bad(rng: Rng, n: int, *, one_in: int, slower: float) -> Floats:
    """One boot in so many is slower by so many percent."""
    return rng.normal(size=n) + (rng.random(n) < 1 / one_in) * slower / 100 / OF_BOOTS


def days(rng: Rng, boots: Callable[[Rng, int], Floats], n: int) -> tuple[Floats, list[str]]:
    """The figure of each run of n days, and the boot of each run."""
    levels = 1 + OF_BOOTS * boots(rng, n)
    runs = np.repeat(levels, 2) + OF_RUNS * rng.normal(size=2 * n)
    return 100 * runs, [str(k // 2) for k in range(2 * n)]


T = TypeVar("T")
ASKED_MAX = 3


class Word(StrEnum):
    """What a gate finally answers about a build; ASKED where it asks for a second boot of it first."""

    ASKED = auto()
    WORSE = auto()


def is_said(
    word: Word, build: list[T], another: Callable[[], T], compare: Callable[[list[T]], history.Against]
) -> bool:
    """Whether a gate says so of the boots of a build, when another is measured as often as it asks, but for three."""
    against = compare(build)
    if word is Word.ASKED:
        return against.exceeds
    for _ in range(ASKED_MAX):
        if not against.exceeds or against.worse:
            break
        build = [*build, another()]
        against = compare(build)
    return against.worse


def alarm_in_a_year(
    rng: Rng,
    *,
    boots: Callable[[Rng, int], Floats],
    year: int = 365,
    margin: float = 0.0,
    slower: float = 0.0,
    word: Word = Word.WORSE,
) -> bool:
    """Whether any of a year's daily gates says so of a build that is slower by `slower` percent, with a margin in
    percent.

    Two spreads of a boot, the least margin, are 4.5 % here. Boots that the gate asks for are not archived.
    """
    runs, units = days(rng, boots, BEFORE + year)
    values = means_of_units(runs, units)
    values[BEFORE:] += slower
    level = history.level_of_test(FALSE_ALARMS, 1)

    def another() -> float:
        return float(means_of_units(*days(rng, boots, 1))[0]) + slower

    def of_day(day: int) -> Callable[[list[float]], history.Against]:
        return lambda build: history.compare_figure(values[:day], np.array(build), margin=margin, level=level)

    return any(is_said(word, [values[day]], another, of_day(day)) for day in range(BEFORE, BEFORE + year))


Misses = Callable[[Rng, float, int], list[tuple[int, int]]]
"""(measurements, misses) of n boots, so many misses a boot on average."""


def misses_of_boots(rng: Rng, mean: float, n: int) -> list[tuple[int, int]]:
    """The rate of a boot varies by a half."""
    return [(MEASUREMENTS, int(misses)) for misses in rng.poisson(mean * rng.gamma(4, 1 / 4, n))]


def misses_in_bursts(rng: Rng, mean: float, n: int, *, length: int) -> list[tuple[int, int]]:
    """Bursts of this mean length."""
    numbers = rng.poisson(mean / length, n)
    return [(MEASUREMENTS, int(rng.geometric(1 / length, number).sum())) for number in numbers]


def misses_of_bad_boots(rng: Rng, mean: float, n: int, *, one_in: int, times: int) -> list[tuple[int, int]]:
    """One boot in so many misses so many times as often."""
    rates = mean * np.where(rng.random(n) < 1 / one_in, times, 1)
    return [(MEASUREMENTS, int(misses)) for misses in rng.poisson(rates)]


def miss_alarm_in_a_year(rng: Rng, *, mean: float, misses: Misses = misses_of_boots, word: Word = Word.WORSE) -> bool:
    """Whether any of a year's daily gates says so of a build for its misses, though nothing changes.

    The condition that takes little time is asked first: `compare_misses` needs both.
    """
    boots = misses(rng, mean, BEFORE + 365)
    level = history.level_of_test(FALSE_ALARMS, 1)

    def of_day(day: int) -> Callable[[list[tuple[int, int]]], history.Against]:
        return lambda build: history.compare_misses(boots[:day], build, level=level)

    return any(
        is_said(word, [boots[day]], lambda: misses(rng, mean, 1)[0], of_day(day))
        for day in range(BEFORE, BEFORE + 365)
        if history.chance_of_misses(boots[:day], [boots[day]]) < level
    )


def build_that_misses_fails(rng: Rng, *, mean: float, times: float, word: Word) -> bool:
    """Whether that is the answer about a build that misses so many times as often, against 90 boots."""
    level = history.level_of_test(FALSE_ALARMS, 4)
    old = misses_of_boots(rng, mean, 90)

    def another() -> tuple[int, int]:
        return misses_of_boots(rng, mean * times, 1)[0]

    return is_said(word, [another()], another, lambda build: history.compare_misses(old, build, level=level))


def misses_are_noticed(rng: Rng, *, mean: float) -> bool:
    """Whether a second boot is asked for of a build that misses as often as the gate says would be noticed."""
    level = history.level_of_test(FALSE_ALARMS, 4)
    old = misses_of_boots(rng, mean, 90)
    noticed = history.compare_misses(old, old[:1], level=level).noticed
    new = misses_of_boots(rng, noticed * MEASUREMENTS, 1)
    return history.compare_misses(old, new, level=level).exceeds


def change_seen(rng: Rng, *, boots: Callable[[Rng, int], Floats], n: int = 120) -> bool:
    """Whether a course of n boots without a change shows one."""
    return bool(find_changes(means_of_units(*days(rng, boots, n))))


def worse_build_fails(rng: Rng, *, shift: float, boots: int, margin: float = 5.0, word: Word = Word.WORSE) -> bool:
    """Whether that is the answer to a build that is slower by `shift` percent against 90 boots. The margin is 5 %."""
    values = means_of_units(*days(rng, normal, 90 + boots))
    level = history.level_of_test(FALSE_ALARMS, 4)  # of the four figures of a scenario

    def another() -> float:
        return float(means_of_units(*days(rng, normal, 1))[0]) + shift

    def compare(build: list[float]) -> history.Against:
        return history.compare_figure(values[:90], np.array(build), margin=margin, level=level)

    return is_said(word, [float(value) + shift for value in values[90:]], another, compare)


def slower_is_noticed(rng: Rng, *, boots: Callable[[Rng, int], Floats]) -> bool:
    """Whether a second boot is asked for of a build as slow as the gate says would be noticed."""
    values = means_of_units(*days(rng, boots, 91))
    level = history.level_of_test(FALSE_ALARMS, 4)
    against = history.compare_figure(values[:90], values[:1], margin=5.0, level=level)
    build = values[90:] - 100 + against.noticed
    return history.compare_figure(values[:90], build, margin=5.0, level=level).exceeds


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
    draws: int = DRAWS


_YEAR = "WORSE, falsely, on any day of a year of daily gates"
_ASKED = "a second boot is asked for, falsely, on any day of a year"
_WORD = {Word.WORSE: _YEAR, Word.ASKED: _ASKED}
# 5 %, and two standard errors of the draws, in percent.
_FIVE_PERCENT, _FIVE_PERCENT_OF_YEARS = (
    float(round(5 + 200 * np.sqrt(0.05 * 0.95 / draws))) for draws in (DRAWS, DRAWS_OF_YEARS)
)

# 90 %, less two standard errors of the draws.
_NINE_TENTHS = float(round(90 - 200 * np.sqrt(0.1 * 0.9 / DRAWS)))


ROWS = (
    *(
        Row(
            name=f"{_YEAR}, boots {kind.__name__}, no margin given",
            draw=partial(alarm_in_a_year, boots=kind),
            at_most=_FIVE_PERCENT_OF_YEARS,
            draws=DRAWS_OF_YEARS,
        )
        for kind in (normal, skewed, weekly, two_kinds, heavy, drifting)
    ),
    *(
        Row(
            name=f"{_YEAR}, boots {kind.__name__}, margin 10 %, builds slower by {slower:g} %",
            draw=partial(alarm_in_a_year, boots=kind, margin=10.0, slower=slower),
            at_most=_FIVE_PERCENT_OF_YEARS,
            draws=DRAWS_OF_YEARS,
        )
        for kind, slower in ((skewed, 3.0), (drifting, 3.0), (normal, 10.0))
    ),
    *(
        Row(
            name=f"{_WORD[word]}, one boot in {one_in} slower by {slower:g} %",
            draw=partial(alarm_in_a_year, boots=partial(rare_bad, one_in=one_in, slower=slower), word=word),
            at_most=_FIVE_PERCENT_OF_YEARS if word is Word.WORSE else 100.0,
            draws=DRAWS_OF_YEARS,
        )
        for one_in, slower in ((50, 15.0), (50, 30.0), (200, 30.0), (20, 15.0))
        for word in Word
    ),
    *(
        Row(
            name=f"{_WORD[word]}, P(miss), {mean:g} misses a boot{kind}",
            draw=partial(miss_alarm_in_a_year, mean=mean, misses=misses, word=word),
            at_most=_FIVE_PERCENT if word is Word.WORSE else 100.0,
        )
        for mean, kind, misses in (
            (0.05, "", misses_of_boots),
            (3.0, "", misses_of_boots),
            (0.1, " in bursts of 5", partial(misses_in_bursts, length=5)),
            (0.5, " in bursts of 20", partial(misses_in_bursts, length=20)),
            (3.0, " in bursts of 20", partial(misses_in_bursts, length=20)),
            (0.05, ", one in 50 has 200 times as many", partial(misses_of_bad_boots, one_in=50, times=200)),
            (3.0, ", one in 50 has 20 times as many", partial(misses_of_bad_boots, one_in=50, times=20)),
            (3.0, ", one in 20 has 20 times as many", partial(misses_of_bad_boots, one_in=20, times=20)),
        )
        for word in Word
    ),
    *(
        Row(name=f"a change in 120 boots without one, boots {kind.__name__}", draw=partial(change_seen, boots=kind),
            at_most=100.0 if kind is drifting else _FIVE_PERCENT)
        for kind in (normal, skewed, two_kinds, heavy, drifting)
    ),
    *(
        Row(
            name=f"a build slower by {shift:g} % is {said}, {boots} boot{'s' * (boots > 1)}, margin 5 %",
            draw=partial(worse_build_fails, shift=shift, boots=boots, word=word),
            at_least=least,
        )
        for shift, boots, word, said, least in (
            (10, 1, Word.ASKED, "noticed", 0),
            (15, 1, Word.ASKED, "noticed", 40),
            (20, 1, Word.ASKED, "noticed", 90),
            (15, 1, Word.WORSE, "WORSE in the end", 40),
            (20, 1, Word.WORSE, "WORSE in the end", 85),
            (10, 3, Word.WORSE, "WORSE", 0),
            (15, 3, Word.WORSE, "WORSE", 90),
        )
    ),
    *(
        Row(
            name=f"a build that misses {times:g} times as often is {said}, {mean:g} misses a boot before",
            draw=partial(build_that_misses_fails, mean=mean, times=times, word=word),
            at_least=least if word is Word.WORSE else 0.0,
        )
        for mean, times, least in ((0.05, 300, 80), (1, 5, 0), (3, 5, 0), (10, 5, 0), (3, 20, 80))
        for word, said in ((Word.ASKED, "noticed"), (Word.WORSE, "WORSE in the end"))
    ),
    *(
        Row(
            name=f"a build as slow as the gate says is noticed, boots {kind.__name__}",
            draw=partial(slower_is_noticed, boots=kind),
            at_least=_NINE_TENTHS,
        )
        for kind in (normal, skewed, two_kinds)
    ),
    *(
        Row(
            name=f"a build that misses as often as the gate says is noticed, {mean:g} misses a boot before",
            draw=partial(misses_are_noticed, mean=mean),
            at_least=_NINE_TENTHS,
        )
        for mean in (0.05, 1, 10)
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
    parser.add_argument("--draws", type=float, default=1.0, help="of the full number of draws; not 1: not written [1]")
    args = parser.parse_args()
    failed = 0
    for row in ROWS:
        if args.only not in row.name:
            continue
        start, rng, draws = time.monotonic(), np.random.default_rng(SEED), max(2, round(row.draws * args.draws))
        events = sum(row.draw(rng) for _ in range(draws))
        share = 100 * events / draws
        holds = row.at_least <= share <= row.at_most
        failed += not holds
        line = f"| {row.name} | {share_text(events, draws)} | {bound_of(row)} | {draws} |"
        if draws == row.draws:
            write_rows(DOCS, BEGIN, HEAD, [line], [row.name for row in ROWS])
        print(f"{'ok    ' if holds else 'FAILED'} {line} in {time.monotonic() - start:.0f} s", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
