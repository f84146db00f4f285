"""Axes: whatever the values, most of them can be told apart, and none is beyond an end."""

import numpy as np
import pytest

from rtrun.analysis.histogram import from_samples
from rtrun.analysis.scale import Division, Scale, scale_of

RNG = np.random.default_rng(1)
NARROW = RNG.normal(90_000, 5_000, 20_000)
JITTER = RNG.normal(0, 20_000, 20_000)


def with_outliers(values, *outliers):
    return from_samples(np.concatenate([values, outliers]).astype(np.int64))


@pytest.mark.parametrize(
    ("values", "limit_ns", "division", "holds_limit"),
    [
        ((NARROW,), None, Division.LINEAR, False),
        ((NARROW,), 150_000, Division.LINEAR, True),
        ((NARROW,), 400_000, Division.LOG, True),
        ((NARROW,), 10**9, Division.LINEAR, False),
        ((NARROW, 2e6), None, Division.STRETCHED, False),
        ((JITTER, -88e6, 88e6), 400_000, Division.STRETCHED, True),
        ((2000 + RNG.lognormal(11, 1.5, 20_000),), 400_000, Division.LOG, True),
        (([5_000],), None, Division.LINEAR, False),
    ],
)
def test_the_bulk_is_seen(values, limit_ns, division, holds_limit):
    bins = with_outliers(*values)
    scale = scale_of(bins, limit_ns)
    assert scale.division is division and (limit_ns is not None and scale.low <= limit_ns <= scale.high) == holds_limit
    first, last = np.quantile(np.repeat(bins.values_ns, bins.counts), [0.01, 0.99])
    assert np.diff(scale.at([first, last + bins.bin_ns])) >= 0.1
    assert scale.at([scale.low, scale.high]).tolist() == [0, 1] and scale.low <= bins.values_ns[0]
    edges = scale.edges(240, 1000.0)
    assert np.all(np.diff(edges) > 0) and edges.size <= 242 and not np.any(edges % 1000)
    assert edges[0] <= bins.values_ns[0] and edges[-1] > bins.values_ns[-1]


@pytest.mark.parametrize("division", Division)
def test_a_place_and_its_value_are_each_others(division):
    scale = Scale(division=division, low=1.0, high=1e6, middle=50.0, spread=10.0)
    values = np.geomspace(1, 1e6, 20)
    assert scale.values_at(scale.at(values)) == pytest.approx(values)
