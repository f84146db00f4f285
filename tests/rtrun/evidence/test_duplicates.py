"""The same counts under another name are one measurement; the same few counts are not known to be."""

import numpy as np
import pytest

from rtrun.analysis.histogram import Histogram, from_samples
from rtrun.evidence.duplicates import BY_CHANCE, chance_of_same_counts, copies_among


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
