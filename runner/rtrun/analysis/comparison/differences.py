"""Do two sets of runs differ? They are compared by resampling blocks, runs or boots, never single measurements."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import normal_quantile, student_quantile
from rtrun.analysis.chance.intervals import clopper_pearson
from rtrun.analysis.comparison.effects import holm
from rtrun.analysis.deadline import Verdict
from rtrun.analysis.dependence.blocks import Blocks, align
from rtrun.analysis.dependence.interleaving import is_interleaved
from rtrun.kinds.values import Int64s

ROUNDS = 999
SEED = 20140715
QUANTILES = (0.5, 0.9, 0.99, 0.999, 0.9999)
# With so many runs on each side whole runs are resampled, so the interval includes the differences between boots.
_RUNS_AS_UNITS = 5
_LEAST_UNITS = 5
# A quantile needs so many values beyond it in each set.
_BEYOND = 20


class ComparisonAnswer(StrEnum):
    """What can be said about two sets.

    RUNS_DIFFER: the runs at hand differ, but they are too few to speak for all, or were not measured in turn.
    """

    DIFFERENT = "DIFFERENT"
    RUNS_DIFFER = "THESE RUNS DIFFER"
    SAME = "NO DIFFERENCE"
    NOT_SEEN = "NO DIFFERENCE SEEN"
    UNDECIDED = "TOO LITTLE DATA"


@dataclass(frozen=True, kw_only=True)
class Shift:
    """B minus A of one figure, with its interval; None if one set is too small for the figure."""

    figure: str
    a_ns: float
    b_ns: float
    low_ns: float
    high_ns: float
    margin_ns: float

    @property
    def shift_ns(self) -> float:
        """B minus A."""
        return self.b_ns - self.a_ns

    @property
    def seen(self) -> bool:
        """The interval excludes no change."""
        return self.low_ns > 0 or self.high_ns < 0

    @property
    def within_margin(self) -> bool:
        """The interval excludes every change as large as the margin (equivalence, Schuirmann 1987)."""
        return -self.margin_ns < self.low_ns and self.high_ns < self.margin_ns


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two sets, compared; without shifts if there are too few data.

    ``distance`` is the largest difference of the distribution functions (0 to 1), ``p_value`` the chance of one as
    large if both sets came from one process. ``units`` is what was resampled: 'runs', 'boots' if the sets have no boot
    in common, or 'blocks' if there are too few runs or boots to know how much they differ. ``interleaved``: the runs
    were measured in turn.
    """

    answer: ComparisonAnswer
    shifts: tuple[Shift, ...]
    distance: float
    p_value: float
    units: str
    unit_counts: tuple[int, int]
    interleaved: bool
    confidence: float
    seed: int
    assumes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """P(miss) of B over that of A with its interval; ``value`` is None when neither set has a miss."""

    value: float | None
    low: float
    high: float


def compare(
    a: Sequence[Blocks],
    b: Sequence[Blocks],
    *,
    confidence: float = 0.95,
    margin_ns: float | None = None,
    clock_step_ns: int = 1,
    tests: int = 1,
) -> Comparison:
    """Compare two sets of runs of the same series; the default margin is 5 % of A's figure.

    It is one of `tests` comparisons that `correct` takes together.

    DIFFERENT needs five runs a side (five boots, where the sets have none in common), measured in turn.

    Shifts: percentile intervals of the block bootstrap (Carlstein 1986). Distance: Kolmogorov-Smirnov statistic under
    permutation of blocks or runs (Lahiri 2003, chapter 2). Quantiles come from counts in bins, with values spread
    evenly over a bin, or over a step of the clock if that is wider. Raises ValueError when a set is empty.
    """
    if not any(run.n for run in a) or not any(run.n for run in b):
        raise ValueError("one of the two sets has no measurement")
    columns, bin_ns, (rows_a, rows_b) = align((a, b))
    keys_a, keys_b, units_name = _units(a, b)
    counts = len(set(keys_a)), len(set(keys_b))
    whole_runs = min(counts) >= _RUNS_AS_UNITS
    assumes = []
    if whole_runs:
        rows_a, rows_b = [_sums_by_key(rows_a, keys_a)], [_sums_by_key(rows_b, keys_b)]
    else:
        if any(not run.ordered for run in (*a, *b)):
            assumes.append("independent measurements: a log without samples keeps no order")
        assumes.append(
            f"{units_name} alike: with {counts[0]} and {counts[1]} of them the difference between them is not in the "
            "intervals"
        )
    rng = np.random.default_rng(SEED)
    sides = _side(a, rows_a, rng), _side(b, rows_b, rng)
    units = len(sides[0].units), len(sides[1].units)
    bins = _Bins(lowest_ns=columns, width_ns=max(bin_ns, clock_step_ns))
    shifts = _shifts(sides, bins, confidence, margin_ns)
    rounds = max(ROUNDS, math.ceil(2 * tests / (1 - confidence)))
    distance, p_value = _permutation_test(sides[0].units, sides[1].units, rng, rounds)
    interleaved = is_interleaved([run.start_time for run in a], [run.start_time for run in b])
    if min(units) < _LEAST_UNITS:
        answer = ComparisonAnswer.UNDECIDED
    elif p_value < 1 - confidence:
        answer = ComparisonAnswer.DIFFERENT if whole_runs and interleaved else ComparisonAnswer.RUNS_DIFFER
    else:
        answer = _no_difference(shifts)
    return Comparison(
        answer=answer,
        shifts=() if answer == ComparisonAnswer.UNDECIDED else shifts,
        distance=distance,
        p_value=p_value,
        units=units_name if whole_runs else "blocks",
        unit_counts=units,
        interleaved=interleaved,
        confidence=confidence,
        seed=SEED,
        assumes=tuple(assumes),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Side:
    """One of two sets: counts of its units (u, m), of the sets drawn from it (ROUNDS, m), and of all together (1,
    m)."""

    units: Int64s
    drawn: NDArray[np.float64]
    whole: Int64s
    n: int
    mean_ns: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Bins:
    """Bins: their lower edges (m,), and how wide values are spread in them."""

    lowest_ns: Int64s
    width_ns: int


def _side(runs: Sequence[Blocks], strata: Sequence[Int64s], rng: np.random.Generator) -> _Side:
    units = np.concatenate(strata)
    n = sum(run.n for run in runs)
    mean_ns = sum(float(run.sums_ns.sum()) for run in runs) / n
    return _Side(units=units, drawn=_resample(strata, rng), whole=units.sum(axis=0)[None], n=n, mean_ns=mean_ns)


def _shifts(sides: tuple[_Side, _Side], bins: _Bins, confidence: float, margin_ns: float | None) -> tuple[Shift, ...]:
    """How far the mean and each quantile with enough values above it moved."""
    a, b = sides
    widening = _few_units(min(len(a.units), len(b.units)), confidence)
    tail = 100 * (1 - confidence) / 2
    shifts = []
    for name, (at_a, at_b), draws in _figures(a, b, bins):
        seen = at_b - at_a
        low, high = seen + widening * (np.percentile(draws, [tail, 100 - tail]) - seen)
        margin = margin_ns if margin_ns is not None else max(1000.0, 0.05 * abs(at_a))
        shifts.append(
            Shift(figure=name, a_ns=at_a, b_ns=at_b, low_ns=float(low), high_ns=float(high), margin_ns=margin)
        )
    return tuple(shifts)


def _figures(a: _Side, b: _Side, bins: _Bins) -> Iterator[tuple[str, tuple[float, float], NDArray[np.float64]]]:
    """Yield each figure: its name, its value on both sides, and its shift in the sets drawn, (ROUNDS,)."""
    # Means are those of the values themselves. For drawn sets, they are known only to the width of a bin.
    means = [[_means(counts, bins.lowest_ns) for counts in (side.whole, side.drawn)] for side in (a, b)]
    off = (b.mean_ns - a.mean_ns) - float((means[1][0] - means[0][0])[0])
    yield "mean", (a.mean_ns, b.mean_ns), means[1][1] - means[0][1] + off
    for q in QUANTILES:
        if min(a.n, b.n) >= round(_BEYOND / (1 - q)):
            at_a, at_b = (float(_quantiles(side.whole, bins, q)[0]) for side in (a, b))
            yield f"p{100 * q:g}", (at_a, at_b), _quantiles(b.drawn, bins, q) - _quantiles(a.drawn, bins, q)


def _no_difference(shifts: Sequence[Shift]) -> ComparisonAnswer:
    return ComparisonAnswer.SAME if all(shift.within_margin for shift in shifts) else ComparisonAnswer.NOT_SEEN


def correct(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Comparisons of the same confidence taken together (Holm 1979): the chance that any of them shows a difference
    where there is none is at most 1 - confidence."""
    decided = [comparison for comparison in comparisons if comparison.answer is not ComparisonAnswer.UNDECIDED]
    rejected = iter(holm([comparison.p_value for comparison in decided], 1 - decided[0].confidence) if decided else [])
    return [
        comparison
        if comparison.answer is ComparisonAnswer.UNDECIDED
        or next(rejected)
        or comparison.answer not in (ComparisonAnswer.DIFFERENT, ComparisonAnswer.RUNS_DIFFER)
        else replace(comparison, answer=_no_difference(comparison.shifts))
        for comparison in comparisons
    ]


def ratio_of_misses(a: Verdict, b: Verdict, confidence: float = 0.95) -> Ratio:
    """P(miss) of B over A: exact, given the sum of misses (Przyborowski & Wilenski 1940), on effective numbers."""
    k_a, k_b = a.misses / a.design_effect, b.misses / b.design_effect
    if not a.n or not b.n or not (k_a or k_b):
        return Ratio(value=None, low=0.0, high=math.inf)
    low, high = clopper_pearson(k_b, k_a + k_b, confidence)
    exposure = a.n_effective / b.n_effective
    return Ratio(
        value=b.p_miss / a.p_miss if a.p_miss else math.inf,
        low=exposure * low / (1 - low) if low < 1 else math.inf,
        high=exposure * high / (1 - high) if high < 1 else math.inf,
    )


def _few_units(units: int, confidence: float) -> float:
    """By which factor percentile intervals from few units are too narrow: Student's t over the normal quantile."""
    if units < 2:
        return 1.0
    middle = (1 + confidence) / 2
    return student_quantile(middle, units - 1) / normal_quantile(middle) * math.sqrt(units / (units - 1))


def _resample(strata: Sequence[Int64s], rng: np.random.Generator) -> NDArray[np.float64]:
    """Counts (ROUNDS, m) of sets drawn with replacement, from each stratum (run) as many units as it has."""
    total = np.zeros((ROUNDS, strata[0].shape[1]))
    for rows in strata:
        weights = rng.multinomial(len(rows), np.full(len(rows), 1 / len(rows)), size=ROUNDS)
        total += weights.astype(np.float64) @ rows.astype(np.float64)
    return total


def _means(counts: NDArray[np.generic], columns: Int64s) -> NDArray[np.float64]:
    sizes = np.maximum(counts.sum(axis=1), 1)
    return np.asarray(counts @ columns.astype(np.float64) / sizes)


def _quantiles(counts: NDArray[np.generic], bins: _Bins, q: float) -> NDArray[np.float64]:
    below = np.cumsum(counts, axis=1, dtype=np.float64)
    rank = q * below[:, -1:]
    column = (below >= rank).argmax(axis=1)[:, None]
    inside = np.take_along_axis(counts, column, axis=1)
    within = 1 - (np.take_along_axis(below, column, axis=1) - rank) / np.maximum(inside, 1)
    return np.asarray((bins.lowest_ns[column] + bins.width_ns * within)[:, 0], dtype=np.float64)


def _units(a: Sequence[Blocks], b: Sequence[Blocks]) -> tuple[list[str], list[str], str]:
    """The unit of each run of both sets, and the unit's name: the boot if the sets have none in common, else the
    run."""
    boots = {run.boot for run in a}, {run.boot for run in b}
    if "" in boots[0] | boots[1] or boots[0] & boots[1]:
        return [str(k) for k in range(len(a))], [str(k) for k in range(len(b))], "runs"
    return [run.boot for run in a], [run.boot for run in b], "boots"


def _sums_by_key(rows: Sequence[Int64s], keys: Sequence[str]) -> Int64s:
    """Counts (u, m) of each unit, from the blocks of its runs."""
    return np.array(
        [sum(row.sum(axis=0) for row, own in zip(rows, keys, strict=True) if own == key) for key in dict.fromkeys(keys)]
    )


def _permutation_test(rows_a: Int64s, rows_b: Int64s, rng: np.random.Generator, rounds: int) -> tuple[float, float]:
    rows = np.concatenate((rows_a, rows_b)).astype(np.float64)
    total = rows.sum(axis=0)

    def distances(in_a: NDArray[np.float64]) -> NDArray[np.float64]:
        first = in_a @ rows
        second = total - first
        gap = np.cumsum(first, axis=1) / first.sum(axis=1, keepdims=True)
        gap -= np.cumsum(second, axis=1) / second.sum(axis=1, keepdims=True)
        return np.asarray(np.abs(gap).max(axis=1))

    truth = np.zeros((1, len(rows)))
    truth[0, : len(rows_a)] = 1
    seen = float(distances(truth)[0])
    shuffled = rng.permuted(np.repeat(truth, rounds, axis=0), axis=1)
    reached = 0
    for part in np.array_split(shuffled, max(1, rounds * rows.shape[1] // 2_000_000)):
        reached += int((distances(part) >= seen - 1e-12).sum())
    return seen, (1 + reached) / (1 + rounds)
