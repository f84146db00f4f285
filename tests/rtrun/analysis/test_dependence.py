"""Bursts and clusters: block sums, design effects, and the exact test of a few misses."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtrun.analysis.dependence.design_effect import (
    chance_of_gaps,
    cluster_effect,
    design_effect,
    effect_of_few,
    extremal_index,
    locate,
    pool,
)


@given(st.sets(st.integers(0, 199)), st.integers(200, 260))
def test_block_sums_are_those_of_counting(positions: set[int], loops: int) -> None:
    located = locate(np.array(sorted(positions), dtype=np.int64), loops)
    events = np.zeros(loops, dtype=np.int64)
    events[sorted(positions)] = 1
    for scale, (whole, count, squares) in enumerate(located.blocks):
        size = 2 << scale
        sums = events[: loops // size * size].reshape(-1, size).sum(axis=1)
        assert (whole, count, squares) == (len(sums), sums.sum(), (sums**2).sum())


def test_no_block_spans_two_runs() -> None:
    a, b = locate(np.array([4]), 5), locate(np.array([0]), 5)
    assert pool([a, b]).blocks[0] == (4, 1, 1)
    assert (pool([a, b]).loops, pool([a, b]).count) == (10, 2)


def test_the_design_effect_of_bursts_is_what_theory_says() -> None:
    rng = np.random.default_rng(3)
    sizes = rng.geometric(1 / 10, 400)
    starts = np.sort(rng.choice(200_000 // 100, 400, replace=False)) * 100
    places = np.unique(np.concatenate([s + np.arange(size) for s, size in zip(starts, sizes, strict=True)]))
    expected = float((sizes**2).mean() / sizes.mean())
    assert design_effect(locate(places, 200_000)) == pytest.approx(expected, rel=0.2)
    assert extremal_index(places) == pytest.approx(1 / sizes.mean(), rel=0.25)
    scattered = np.sort(rng.choice(200_000, 2000, replace=False))
    assert design_effect(locate(scattered, 200_000)) < 1.2
    assert extremal_index(scattered) > 0.9


@pytest.mark.parametrize(("n", "k", "gap", "short"), [(12, 2, 1, 1), (12, 4, 2, 1), (12, 4, 2, 2), (11, 5, 1, 3)])
def test_the_chance_of_short_distances_is_that_of_counting(n: int, k: int, gap: int, short: int) -> None:
    draws = [np.diff(places) for places in combinations(range(n), k)]
    counted = sum((gaps <= gap).sum() >= short for gaps in draws) / len(draws)
    assert chance_of_gaps(n, k, gap, short) == pytest.approx(counted)


@pytest.mark.parametrize(
    ("places", "effect"),
    [
        ((7,), 1.0),
        ((7, 50_000), 1.0),
        ((7, 8), 2.0),
        ((7, 9), 2.0),
        ((7, 8, 9, 50_000), 2.5),
    ],
)
def test_a_few_misses_form_the_bursts_that_one_sees(places: tuple[int, ...], effect: float) -> None:
    assert effect_of_few(np.array(places), 100_000) == effect


def test_a_few_misses_at_even_distances_are_no_burst() -> None:
    assert effect_of_few(np.arange(500, 10_000, 1000), 10_000) == 1.0


def test_chance_rarely_makes_a_burst() -> None:
    rng = np.random.default_rng(4)
    effects = [effect_of_few(np.sort(rng.choice(10_000, 8, replace=False)), 10_000) for _ in range(400)]
    assert np.mean(np.array(effects) > 1) <= 0.07


def test_clusters() -> None:
    assert cluster_effect([(1000, 5), (1000, 5)]) == 0.0
    assert cluster_effect([(1000, 0), (1000, 1)]) == pytest.approx(1, rel=0.01)
    assert cluster_effect([(1000, 0)] * 7 + [(1000, 40)]) == pytest.approx(40, rel=0.02)
    assert cluster_effect([(1000, 0), (1000, 0)]) == cluster_effect([(1000, 3)]) == cluster_effect([]) == 1.0


def test_independent_events_rarely_seem_to_come_together() -> None:
    """At each length of blocks once in two hundred times, and it is the same blocks again at the next one."""
    rng = np.random.default_rng(5)
    seem = [design_effect(locate(np.sort(rng.choice(20_000, 200, replace=False)), 20_000)) > 1 for _ in range(1000)]
    assert 0.003 < np.mean(seem) < 0.04


def test_few_pairs_of_events_are_seen() -> None:
    """Of 400 events 60 come twice: an effect of 1.3, which a larger threshold would leave out."""
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(100):
        starts = np.sort(rng.choice(10_000, 340, replace=False)) * 4
        places = np.unique(np.concatenate((starts, rng.choice(starts, 60, replace=False) + 1)))
        seen += design_effect(locate(places, 40_000)) > 1.1
    assert seen > 60
