"""Alarms of gates against history, in short: `make coverage` simulates whole years (tests/coverage/years.py)."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from rtrun.analysis.comparison import history
from rtrun.analysis.order.change_points import find_changes, means_of_units

# At the end: nothing here may stand in for a module of another folder.
sys.path.append(str(Path(__file__).parent))
import years

LEVEL = 0.01
LEVEL_OF_A_YEAR = history.level_of_test(years.FALSE_ALARMS, 1)
DRAWS = 1500
AT_MOST = 2.0  # percent: 1 %, and four standard errors


def percent_of_alarms(boots, unit):
    """How often the gate of one day fails a build of three boots against 40, at a level of 1 %, nothing changed."""
    rng, alarms = np.random.default_rng(20140715), 0
    for _ in range(DRAWS):
        runs, units = years.days(rng, boots, 43)
        old, new = (means_of_units(runs[part], unit(units[part])) for part in (slice(80), slice(80, None)))
        alarms += history.compare_figure(old, new, margin=0.0, level=LEVEL).exceeds
    return 100 * alarms / DRAWS


def by_boot(units):
    return units


def by_run(units):
    return [str(k) for k in range(len(units))]


@pytest.fixture
def without_margin(monkeypatch):
    monkeypatch.setattr(history, "LEAST_MARGIN", 0.0)


@pytest.fixture
def without_change_points(monkeypatch, without_margin):
    """So that the level of the test alone is seen; the lowest of several levels is chosen, which adds to it."""
    monkeypatch.setattr(history, "levels", lambda values: [slice(0, len(values))])


@pytest.mark.parametrize("boots", [years.normal, years.skewed, years.two_kinds])
def test_a_gate_fails_as_seldom_as_it_says(without_change_points, boots):
    assert percent_of_alarms(boots, by_boot) <= AT_MOST


def test_with_runs_as_units_it_fails_too_often(without_change_points):
    assert percent_of_alarms(years.normal, by_run) > AT_MOST


def test_an_alarm_in_a_month_of_gates_is_rare():
    """Whole gates, change points with them; a month's share of the year's 5 %, in 100 months none or one."""
    rng = np.random.default_rng(20140715)
    assert sum(years.alarm_in_a_year(rng, boots=years.normal, year=30) for _ in range(25)) <= 1


def test_a_margin_below_that_of_the_boots_changes_nothing(monkeypatch):
    boots = 100 + 2 * np.random.default_rng(20140715).normal(size=40)

    def limit(margin):
        return history.compare_figure(boots, boots[:1], margin=margin, level=LEVEL).limit

    assert limit(0.0) == limit(0.01) < limit(8.0)
    spread = (limit(0.0) - limit_without_margin(monkeypatch, boots)) / history.LEAST_MARGIN
    assert 1.5 < spread < 2.7


def limit_without_margin(monkeypatch, boots):
    with monkeypatch.context() as patch:
        patch.setattr(history, "LEAST_MARGIN", 0.0)
        return history.compare_figure(boots, boots[:1], margin=0.0, level=LEVEL).limit


def test_a_level_of_boots_that_lie_close_together_does_not_say_how_much_boots_differ():
    rng = np.random.default_rng(20140715)
    before, after = (rng.permutation(np.linspace(96, 104, 30)) for _ in range(2))
    close = rng.permutation(np.linspace(89.9, 90.1, 20))
    against = history.compare_figure(np.concatenate([before, close, after]), before[:1], margin=0.0, level=LEVEL)
    assert against.boots == 20
    assert against.limit - against.reference > 8


def test_at_the_level_of_a_single_gate_a_month_has_alarms(monkeypatch, without_margin):
    """What a year of gates takes from the level is needed."""
    monkeypatch.setattr(history, "level_of_test", lambda false_alarms, tests: false_alarms)
    rng = np.random.default_rng(20140715)
    assert sum(years.alarm_in_a_year(rng, boots=years.normal, year=30) for _ in range(25)) > 5


@pytest.mark.parametrize("boots", [years.normal, years.two_kinds])
def test_a_course_without_a_change_seldom_shows_one(boots):
    rng = np.random.default_rng(20140715)
    assert sum(years.change_seen(rng, boots=boots, n=40) for _ in range(200)) <= 20  # 5 %, and three standard errors


def test_runs_of_a_boot_taken_for_boots_show_changes_that_are_none():
    rng = np.random.default_rng(20140715)
    shown = 0
    for _ in range(60):
        levels = np.repeat(100 + 2 * rng.normal(size=8), 10) + rng.normal(size=80)
        shown += bool(find_changes(levels))
    assert shown > 30


def test_power():
    rng = np.random.default_rng(20140715)
    assert sum(years.worse_build_fails(rng, shift=25, boots=1) for _ in range(40)) >= 36
    assert sum(years.build_that_misses_fails(rng, mean=3, times=40, word=years.Word.WORSE) for _ in range(40)) >= 34
    assert sum(years.change_found(rng, shift=6) for _ in range(40)) >= 36


def slow_boot(rng):
    """A month of boots, one in 50 slower by 30 %; the first boot of the build is."""
    kind = partial(years.rare_bad, one_in=50, slower=30)
    old = means_of_units(*years.days(rng, years.normal, 30))

    def another():
        return means_of_units(*years.days(rng, kind, 1))[0]

    def compare(build):
        return history.compare_figure(old, np.array(build), margin=0.0, level=LEVEL_OF_A_YEAR)

    return [130.0], another, compare


def burst_of_misses(rng):
    """A month of boots, one in 40 with a burst of 20 misses; the first boot of the build has."""
    old = years.misses_in_bursts(rng, 0.5, 30, length=20)

    def another():
        return years.misses_in_bursts(rng, 0.5, 1, length=20)[0]

    def compare(build):
        return history.compare_misses(old, build, level=LEVEL_OF_A_YEAR)

    return [(years.MEASUREMENTS, 20)], another, compare


@pytest.mark.parametrize("kind", [slow_boot, burst_of_misses])
@pytest.mark.parametrize("asks", [True, False])
def test_one_bad_boot_makes_no_build_worse(monkeypatch, kind, asks):
    """Of two bad boots in a year with such a chance each the promised 5 % are left; without asking, all count."""
    if not asks:
        monkeypatch.setattr(history.Against, "worse", property(lambda against: against.exceeds))
    rng = np.random.default_rng(20140715)
    share = sum(years.is_said(years.Word.WORSE, *kind(rng)) for _ in range(200)) / 200
    assert share <= 0.025 + 0.025 if asks else share > 0.25


@pytest.mark.parametrize("noticed", [
    partial(years.slower_is_noticed, boots=years.normal),
    partial(years.misses_are_noticed, mean=1),
], ids=["slower", "misses"])  # fmt: skip
def test_what_is_said_to_be_noticed_is(noticed):
    rng = np.random.default_rng(20140715)
    assert sum(noticed(rng) for _ in range(100)) >= 84  # 90 %, and two standard errors
