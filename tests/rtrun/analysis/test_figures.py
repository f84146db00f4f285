"""Figures against an independent, slow way to reach them."""

import json
import math
from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rtrun.analysis.figures import Ranked, figures, figures_of_histogram
from rtrun.analysis.histogram import Histogram

NS = st.integers(-(2**50), 2**50)


def percentile(values: list[int], per_mille: int) -> int:
    """The smallest value such that at least that share of all is not above it, by trying each."""
    share = Fraction(per_mille, 1000)
    return next(v for v in sorted(values) if Fraction(sum(w <= v for w in values), len(values)) >= share)


@given(st.lists(NS | st.integers(-3, 3), min_size=1, max_size=60))
def test_figures_of_samples(values: list[int]) -> None:
    found = figures(np.array(values, dtype=np.int64))
    assert found.n == len(values)
    assert (found.min_us, found.max_us) == (min(values) / 1000, max(values) / 1000)
    assert found.mean_us is not None
    assert math.isclose(found.mean_us, float(Fraction(sum(values), 1000 * len(values))), rel_tol=1e-9, abs_tol=1e-3)
    for name, per_mille in (("p50_us", 500), ("p90_us", 900), ("p99_us", 990), ("p999_us", 999)):
        assert getattr(found, name) == percentile(values, per_mille) / 1000
    falling = sorted((-value, index) for index, value in enumerate(values))[:10]
    assert [(round(-1000 * entry.value_us), entry.index) for entry in found.top] == falling
    rising = sorted((value, index) for index, value in enumerate(values))[:10]
    assert [(round(1000 * entry.value_us), entry.index) for entry in found.lowest] == rising


@given(st.lists(st.integers(-(10**9), 10**9) | st.integers(-3, 3), min_size=1, max_size=60))
def test_bins_give_the_figures_of_the_values_in_them(values_us: list[int]) -> None:
    of_samples = figures(np.array(values_us, dtype=np.int64) * 1000)
    value_us, count = np.unique(np.array(values_us, dtype=np.int64), return_counts=True)
    histogram = Histogram(values_ns=value_us * 1000, counts=count)
    of_bins = figures_of_histogram(histogram, top=of_samples.top, lowest=of_samples.lowest)
    expected = of_samples.as_json() | {"resolution_ns": 1000}
    assert math.isclose(of_bins.as_json().pop("mean_us"), expected.pop("mean_us"), rel_tol=1e-9, abs_tol=1e-9)
    assert {key: value for key, value in of_bins.as_json().items() if key != "mean_us"} == expected


def test_the_index_of_a_sample_is_the_one_given() -> None:
    found = figures(np.array([5000, 9000, 1000]), np.array([40, 41, 43]))
    assert found.top[0] == Ranked(value_us=9.0, index=41)
    assert found.lowest[0] == Ranked(value_us=1.0, index=43)


def test_nothing_measured_gives_no_number_and_valid_json() -> None:
    found = figures(np.array([], dtype=np.int64), missing=7)
    data = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert data["n"] == 0
    assert data["missing"] == 7
    assert data["min_us"] is data["mean_us"] is data["p999_us"] is None
    assert data["top"] == data["lowest"] == []


def test_what_lies_in_the_overflow_is_counted_and_not_known() -> None:
    histogram = Histogram(
        values_ns=np.array([80_000, 9_823_000]),
        counts=np.array([970, 3]),
        overflow=27,
        overflow_from_ns=10_000_000,
        max_ns=14_310_000,
    )
    found = figures_of_histogram(histogram)
    assert (found.n, found.min_us, found.max_us) == (1000, 80.0, 14310.0)
    assert (found.p50_us, found.p90_us) == (80.0, 80.0)
    assert found.mean_us is found.p99_us is found.p999_us is None
    assert found.top == ()
