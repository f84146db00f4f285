"""A start-up that fades is found, in one run and in many; what is none is not."""

import numpy as np
import pytest

from rtrun.analysis.order.startup import MOST, find_startup, head_of, left_out, split

DEADLINE_NS = 400_000
NONE = np.empty(0, np.int64)


def _steady(seed, n=10_000):
    rng = np.random.default_rng(seed)
    return 50_000 + (5000 * rng.standard_exponential(n)).astype(np.int64)


def _fading(seed, n=10_000, memory=125):
    return (_steady(seed, n) * (1 + np.exp(-np.arange(n) / memory))).astype(np.int64)


def _find(*runs):
    return find_startup([[head_of(values, NONE, DEADLINE_NS)] for values in runs])


@pytest.mark.parametrize("runs", [1, 2, 3, 5, 20])
def test_a_startup_that_fades_is_found_until_it_has_faded(runs):
    found = _find(*(_fading(seed) for seed in range(runs)))
    # Values are 4 % higher still after 400 loops, 0.1 % after 800.
    assert found is not None and 300 <= found.loops <= 1300 and found.p_value < 1e-3


def test_more_runs_are_surer():
    chances = [_find(*(_fading(seed) for seed in range(runs))).p_value for runs in (1, 5, 20)]
    assert sorted(chances, reverse=True) == chances and chances[2] < 1e-12 < 1e-9 < chances[0]


def test_nothing_is_found_where_nothing_starts():
    assert _find(*map(_steady, range(5))) is None
    assert find_startup([]) is None
    assert _find(*(_steady(seed, 100) for seed in range(5))) is None
    assert _find(np.full(10_000, 50_000)) is None


@pytest.mark.parametrize("length", [20, 100])
def test_one_burst_at_the_start_of_one_run_is_none(length):
    values = _steady(1)
    values[:length] = 500_000
    assert _find(values) is None
    assert _find(values, *map(_steady, range(2, 6))) is None


def test_a_burst_at_the_start_of_each_run_is_one():
    runs = [_steady(seed) for seed in range(5)]
    for values in runs:
        values[:20] = 500_000
    assert _find(*runs).loops <= 128


def test_outputs_of_one_run_count_as_one():
    outputs = [_steady(seed) for seed in range(5)]
    for values in outputs:
        values[:20] = 500_000
    assert find_startup([[head_of(values, NONE, DEADLINE_NS) for values in outputs]]) is None


def test_what_never_fades_is_left_to_the_tests_of_constancy():
    falling = [(_steady(seed) * np.linspace(2, 1, 10_000)).astype(np.int64) for seed in range(5)]
    assert _find(*falling) is None
    assert _find(*(_fading(seed, memory=3000) for seed in range(5))) is None


def test_no_more_than_a_fifth_of_the_shortest_run_is_left_out():
    assert _find(*(_fading(seed) for seed in range(5))).loops > 900 // MOST
    for n in (900, 1500, 3000, 20_000):
        found = _find(*(_fading(seed) for seed in range(5)), _fading(5, n))
        assert found is None or found.loops <= n // MOST


def test_misses_alone_show_it_in_many_runs():
    runs = []
    for seed in range(20):
        values, rng = _steady(seed), np.random.default_rng(seed)
        values[rng.integers(0, 300, 2)] = 500_000
        values[rng.integers(0, 10_000)] = 500_000
        runs.append(values)
    assert 256 <= _find(*runs).loops <= 512
    assert find_startup([[head_of(values, NONE, 600_000)] for values in runs]) is None


def test_misses_that_come_evenly_from_the_first_loop_on_are_none():
    runs = [_steady(seed) for seed in range(5)]
    for values in runs:
        values[::100] = 500_000
    assert _find(*runs) is None


def test_what_never_came_is_worse_than_all():
    absent = np.arange(0, 40, 2)
    heads = [[head_of(_steady(seed), absent, DEADLINE_NS)] for seed in range(5)]
    assert find_startup(heads).loops <= 128


def test_what_is_left_out_is_counted_and_the_rest_keeps_its_places():
    values = np.array([500_000, 1000, 2000, 600_000, 3000, 4000])
    absent = np.array([1, 5, 7])  # of nine loops
    first, rest, places = split(values, absent, DEADLINE_NS, 5)
    assert (first.n, first.late, first.absent, first.worst_ns) == (5, 2, 1, 600_000)
    assert rest.tolist() == [3000, 4000] and places.tolist() == [0, 2]
    found = _find(*(_fading(seed) for seed in range(2)))
    both = left_out(found, [first, first])
    assert (both.loops, both.late, both.absent, both.worst_ns) == (found.loops, 4, 2, 600_000)
