"""Figures of samples and histograms against slow ways to reach them."""

import statistics
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrun.analysis.figures import PERCENTILES, IndexedValue, figures_of_histogram, figures_of_samples, rank
from rtrun.analysis.histogram import Histogram, from_samples, merge

NS = st.integers(-(2**50), 2**50) | st.integers(-3, 3) | st.integers(10**5, 10**5 + 300)


@given(st.lists(NS, min_size=1, max_size=80))
def test_figures_are_those_of_the_sorted_values(values: list[int]) -> None:
    figures = figures_of_samples(np.array(values, dtype=np.int64))
    rising = sorted(values)
    assert (figures.n, figures.min_ns, figures.max_ns) == (len(values), rising[0], rising[-1])
    assert figures.mean_ns == pytest.approx(statistics.fmean(values), rel=1e-12, abs=1e-6)
    spread = statistics.stdev(values) if len(values) > 1 else 0.0
    assert figures.std_ns == pytest.approx(spread, rel=1e-9, abs=1e-6)
    for percent in PERCENTILES:
        assert figures.percentiles_ns[percent] == rising[rank(len(values), percent) - 1]
    top = sorted((-value, index) for index, value in enumerate(values))[:10]
    assert [(-e.value_ns, e.index) for e in figures.top] == top
    lowest = sorted((value, index) for index, value in enumerate(values))[:10]
    assert [(e.value_ns, e.index) for e in figures.lowest] == lowest


@pytest.mark.parametrize("outlier", [3_600_000_000_000, -3_600_000_000_000, 5_000_000])
def test_one_value_of_hours_does_not_blur_the_others(outlier: int) -> None:
    values = np.random.default_rng(1).gamma(9, 11_000, 300_000).astype(np.int64)
    values[1234] = outlier
    figures = figures_of_samples(values)
    rising = np.sort(values)
    assert [figures.percentiles_ns[p] for p in PERCENTILES] == [rising[rank(values.size, p) - 1] for p in PERCENTILES]
    assert figures.std_ns == pytest.approx(values.std(ddof=1), rel=1e-9)
    assert outlier in (figures.top[0].value_ns, figures.lowest[0].value_ns, figures.top[1].value_ns)


def test_percentiles_are_ranks_without_rounding() -> None:
    assert rank(100_000, 99.999) == 99_999
    assert rank(2_000_000, 99.999) == 1_999_980
    assert rank(7, 99.9) == 7
    assert rank(1, 50) == 1


def test_the_index_is_the_loop_not_the_position() -> None:
    figures = figures_of_samples(np.array([5, 9, 7], dtype=np.int64), np.array([0, 4, 9]))
    assert [(e.value_ns, e.index) for e in figures.top] == [(9, 4), (7, 9), (5, 0)]


def test_nothing_has_no_figures() -> None:
    none = figures_of_samples(np.empty(0, np.int64))
    assert (none.n, none.min_ns, none.mean_ns, none.std_ns, none.percentiles_ns) == (0, None, None, None, {})


@given(st.integers(20_000, 30_000), st.integers(0, 10**6), st.sampled_from([1, 1000, 30_517, 10**9]))
@settings(max_examples=20)
def test_figures_of_many_values_are_those_of_the_sorted_ones(n: int, seed: int, clock_step_ns: int) -> None:
    rng = np.random.default_rng(seed)
    values = (50_000 * rng.lognormal(0, rng.uniform(0, 4), n)).astype(np.int64) // clock_step_ns * clock_step_ns
    figures, rising = figures_of_samples(values), np.sort(values)
    assert (figures.min_ns, figures.max_ns) == (rising[0], rising[-1])
    assert [figures.percentiles_ns[p] for p in PERCENTILES] == [rising[rank(n, p) - 1] for p in PERCENTILES]
    assert figures.std_ns == pytest.approx(values.std(ddof=1), rel=1e-9, abs=1e-6)
    highest, lowest = np.argsort(-values, kind="stable")[:10], np.argsort(values, kind="stable")[:10]
    assert [(e.value_ns, e.index) for e in figures.top] == [(values[at], at) for at in highest]
    assert [(e.value_ns, e.index) for e in figures.lowest] == [(values[at], at) for at in lowest]


def test_the_widest_span_that_is_taken_does_not_overflow() -> None:
    figures = figures_of_samples(np.array([-(2**62), 0, 2**62 - 1], dtype=np.int64))
    assert (figures.min_ns, figures.max_ns, figures.percentiles_ns[50.0]) == (-(2**62), 2**62 - 1, 0)
    assert figures.std_ns == pytest.approx(2.0**62)


@pytest.mark.parametrize(
    "extremes", [(-(2**62), 2**62), (-(2**63), 2**63 - 1)], ids=["span of 2^63", "the whole of int64"]
)
@pytest.mark.parametrize("reduce", [figures_of_samples, from_samples])
def test_a_span_beyond_int64_is_refused(reduce: Callable[[np.ndarray], object], extremes: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="no measured time"):
        reduce(np.array(extremes, dtype=np.int64))


def test_a_bin_at_the_end_of_int64_is_above_a_deadline() -> None:
    bins = Histogram(values_ns=np.array([0, 2**63 - 808], dtype=np.int64), counts=np.array([1, 1]))
    assert bins.above(400_000) == 1


@pytest.mark.parametrize(
    "values", [np.array([1.5, np.nan]), np.zeros((2, 2), np.int64), np.array([-(2**63), 1], dtype=np.int64)]
)
def test_what_is_no_series_of_times_is_refused(values: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"int64|no measured time"):
        figures_of_samples(values)


@given(st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=60), st.sampled_from([1, 10, 1000]))
def test_a_histogram_tells_what_floored_values_tell(values: list[int], width: int) -> None:
    floored = np.array(values, dtype=np.int64) // width * width
    bins = from_samples(np.array(values, dtype=np.int64), width)
    exact, figures = figures_of_samples(floored), figures_of_histogram(bins)
    assert (figures.n, figures.min_ns, figures.max_ns) == (exact.n, exact.min_ns, exact.max_ns)
    assert figures.percentiles_ns == exact.percentiles_ns
    assert figures.mean_ns == pytest.approx(exact.mean_ns, abs=1e-6)
    assert figures.std_ns == pytest.approx(exact.std_ns, abs=1e-3)
    assert [e.value_ns for e in figures.top] == [e.value_ns for e in exact.top]
    with_indices = figures_of_histogram(bins, top=exact.top, lowest=exact.lowest)
    assert (with_indices.top, with_indices.lowest) == (exact.top, exact.lowest)


def test_a_value_beyond_the_end_of_a_printed_list_has_no_index() -> None:
    bins = Histogram(values_ns=np.array([1000, 5000]), counts=np.array([1, 2]))
    figures = figures_of_histogram(bins, top=(IndexedValue(value_ns=5000, index=7),))
    assert [(e.value_ns, e.index) for e in figures.top] == [(5000, 7), (5000, None), (1000, None)]


@given(st.lists(st.lists(st.integers(-5000, 5000), max_size=20), min_size=1, max_size=4))
def test_merged_histograms_are_the_histogram_of_all(parts: list[list[int]]) -> None:
    merged = merge(from_samples(np.array(part, dtype=np.int64), 10) for part in parts)
    whole = from_samples(np.array([v for part in parts for v in part], dtype=np.int64), 10)
    assert merged.values_ns.tolist() == whole.values_ns.tolist()
    assert merged.counts.tolist() == whole.counts.tolist()


def test_what_overflowed_is_left_out_of_the_figures() -> None:
    bins = Histogram(values_ns=np.array([1000, 2000]), counts=np.array([90, 5]), overflow=5, overflow_from_ns=3000)
    figures = figures_of_histogram(bins)
    assert figures.n == 100
    assert figures.mean_ns is None and figures.max_ns is None and figures.top == ()
    assert figures.percentiles_ns == {50.0: 1000, 90.0: 1000, 95.0: 2000}


def test_what_the_measuring_program_printed_is_known_in_spite_of_the_overflow() -> None:
    bins = Histogram(
        values_ns=np.array([1000]), counts=np.array([9]), overflow=1, overflow_from_ns=3000, max_ns=9000, mean_ns=1800.0
    )
    figures = figures_of_histogram(bins)
    assert (figures.max_ns, figures.mean_ns, figures.std_ns) == (9000, 1800.0, None)


def test_a_deadline_in_the_overflow_is_not_guessed() -> None:
    bins = Histogram(values_ns=np.array([1000]), counts=np.array([9]), overflow=1, overflow_from_ns=3000)
    assert bins.above(2500) == 1
    with pytest.raises(ValueError, match="only counted"):
        bins.above(5000)
    known = Histogram(values_ns=np.array([1000]), counts=np.array([9]), overflow=1, overflow_from_ns=3000, max_ns=4000)
    assert known.above(5000) == 0
