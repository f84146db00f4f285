"""The same counts under another name are one measurement; the same few counts are not known to be."""

import numpy as np
import pytest

from rtrun.analysis.histogram import Histogram, from_samples
from rtrun.analysis.trials import count_misses
from rtrun.evidence.duplicates import BY_CHANCE, chance_of_same_counts, copies_among, overlaps_among


def measured(seed, n=2000):
    return from_samples(np.random.default_rng(seed).gamma(4.0, 5000.0, n).astype(np.int64))


def in_bins(*counts):
    return Histogram(values_ns=1000 * np.arange(len(counts)), counts=np.array(counts, np.int64))


def test_three_names_of_one_file_are_copies_of_each_other():
    found = copies_among([("a", measured(1)), ("b", measured(2)), ("c", measured(1)), ("d", measured(1))])
    assert found.keys() == {"a", "c", "d"} and "b" not in found.values()


def test_one_thread_of_several_is_enough_and_two_of_one_run_are_none():
    found = copies_among([("a", measured(1)), ("a", measured(2)), ("b", measured(3)), ("b", measured(1))])
    assert found == {"a": "b", "b": "a"}
    assert copies_among([("a", measured(1)), ("a", measured(1))]) == {}


def test_two_measurements_are_not():
    assert copies_among([(str(seed), measured(seed)) for seed in range(200)]) == {}


def test_what_a_coarse_clock_says_of_every_run_tells_nothing():
    assert chance_of_same_counts(in_bins(10_000)) == 1.0
    assert copies_among([("a", in_bins(10_000)), ("b", in_bins(10_000))]) == {}
    assert copies_among([("a", in_bins(9_990, 10)), ("b", in_bins(9_990, 10))]) == {}
    assert copies_among([("a", in_bins()), ("b", in_bins())]) == {}


@pytest.mark.parametrize("counts", [(3, 1), (40, 30, 30)])
def test_the_chance_is_the_highest_that_any_distribution_gives(counts):
    shares = np.array(counts) / sum(counts)
    draws = np.random.default_rng(1).multinomial(sum(counts), shares, 400_000)
    simulated = (draws == counts).all(axis=1).mean()
    assert chance_of_same_counts(in_bins(*counts)) == pytest.approx(simulated, rel=0.1)


def test_many_bins_make_it_small_enough():
    assert chance_of_same_counts(measured(1)) < BY_CHANCE


def trials(run, values_ns):
    return run, count_misses(np.asarray(values_ns, np.int64), 10**6)


def draws(seed, n=5000, step_ns=1):
    return np.random.default_rng(seed).gamma(4.0, 5000.0, n).astype(np.int64) // step_ns * step_ns


@pytest.mark.parametrize("step_ns", [1, 1000])
@pytest.mark.parametrize("change", ["appended to", "cut off", "without its first lines", "each third value changed"])
def test_a_log_that_was_changed_is_still_the_same_measurement(change, step_ns):
    """As by `tee -a` into one file for all runs, or by whoever wants one run to count twice."""
    original, other = draws(1, step_ns=step_ns), draws(2, step_ns=step_ns)
    copy = {
        "appended to": np.concatenate((original, draws(3, step_ns=step_ns))),
        "cut off": original[:3000],
        "without its first lines": original[1000:],
        "each third value changed": np.where(np.arange(original.size) % 3 == 0, draws(4, step_ns=step_ns), original),
    }[change]
    found = overlaps_among([trials("a", original), trials("b", other), trials("c", copy)])
    assert found == {"a": "c", "c": "a"}


@pytest.mark.parametrize("period", [None, 100, 7])
@pytest.mark.parametrize("startup", [0, 30, 150])
@pytest.mark.parametrize("step_ns", [1, 1000, 10_000, 100_000])
@pytest.mark.parametrize("loops", [200, 5000])
def test_measurements_alike_are_not_the_same(step_ns, startup, period, loops):
    """Also with a coarse clock, a period that both have, and a start-up that is the same in both."""
    runs = []
    for seed in range(60):
        values = draws(seed, loops, step_ns)
        if period:
            values[::period] += 60_000
        values[:startup] = 400_000 - 2000 * np.arange(startup)
        runs.append(trials(str(seed), values))
    assert overlaps_among(runs) == {}


def test_subscribers_of_one_run_share_their_moments():
    assert overlaps_among([trials("a", draws(1)), trials("a", draws(1))]) == {}
