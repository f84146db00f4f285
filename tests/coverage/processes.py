"""Processes whose true P(miss) is known, as runs of int64 samples in ns.

Misses lie far above all other values and nothing else in a run hints at them, unless the process is described as
dependent as a whole.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtri

DEADLINE_NS = 400_000
MISS_NS = 500_000

Rng = np.random.Generator
Int64s = np.ndarray
Process = Callable[[int, float, Rng], Int64s]


def quiet(n: int, rng: Rng) -> Int64s:
    """Independent values that all meet the deadline."""
    return np.minimum(50_000 + rng.standard_exponential(n, np.float32) * 5_000, 300_000).astype(np.int64)


def independent(n: int, p: float, rng: Rng) -> Int64s:
    values = quiet(n, rng)
    values[rng.integers(0, n, rng.binomial(n, p))] = MISS_NS
    return values


def bursts(n: int, p: float, rng: Rng, *, length: float) -> Int64s:
    """Consecutive misses, geometric lengths of this mean; they begin at random."""
    values = quiet(n, rng)
    lead = 20 * math.ceil(length)
    number = rng.poisson((n + lead) * p / length)
    for start, size in zip(rng.integers(-lead, n, number), rng.geometric(1 / length, number), strict=True):
        values[max(0, start) : max(0, start + size)] = MISS_NS
    return values


def clumps(n: int, p: float, rng: Rng, *, size: int, coarse: bool = False) -> Int64s:
    """Groups of so many consecutive misses, that begin at random: p is the rate of their beginnings.

    By a coarse clock all other values are the same.
    """
    values = np.full(n, 50_000) if coarse else quiet(n, rng)
    starts = rng.integers(0, n - size, rng.binomial(n, p))
    values[(starts[:, None] + np.arange(size)).ravel()] = MISS_NS
    return values


GAP = 10
"""Loops at 1 kHz within which two misses are of one episode."""


@dataclass(frozen=True, kw_only=True)
class Lengths:
    """How long episodes are: `chance[j]` that one has more than j misses."""

    chance: np.ndarray

    @property
    def mean(self) -> float:
        return float(self.chance.sum())

    def draw(self, number: int, rng: Rng) -> Int64s:
        return np.searchsorted(-self.chance, -rng.random(number), side="left").astype(np.int64)


LENGTHS = {
    "always 10": Lengths(chance=np.ones(10)),
    "geometric, mean 10": Lengths(chance=0.9 ** np.arange(400)),
    "heavy (Pareto 1.5), 3 to 1000": Lengths(chance=np.minimum(1, (3 / np.arange(1.0, 1001)) ** 1.5)),
}


def episodes(n: int, rate: float, rng: Rng, *, lengths: Lengths) -> Int64s:
    """Consecutive misses, `rate` of them begin in a loop; the time between is GAP loops and geometric beyond these."""
    values = quiet(n, rng)
    between = 1 / rate - lengths.mean - GAP
    lead = round(20 / rate)  # so long before, how it began is forgotten
    number = 60 + round(2 * (n + lead) * rate)
    sizes = lengths.draw(number, rng)
    starts = np.cumsum(rng.geometric(1 / between, number) + GAP + np.concatenate(([0], sizes[:-1]))) - lead
    assert starts[-1] > n
    for start, size in zip(starts, sizes, strict=True):
        values[max(0, start) : max(0, start + size)] = MISS_NS
    return values


def _normal(x: Int64s, p: float) -> Int64s:
    """Standard normal values, scaled so that a fraction p lies above the deadline."""
    return (100_000 + (DEADLINE_NS - 100_000) / -ndtri(p) * x).astype(np.int64)


def autoregressive(n: int, p: float, rng: Rng, *, memory: float) -> Int64s:
    noise = rng.normal(size=n + 200) * math.sqrt(1 - memory**2)
    return _normal(lfilter([1], [1, -memory], noise)[200:], p)


def moving_average(n: int, p: float, rng: Rng, *, width: int) -> Int64s:
    sums = np.cumsum(rng.normal(size=n + width))
    return _normal((sums[width:] - sums[:-width]) / math.sqrt(width), p)


def fractional(n: int, p: float, rng: Rng, *, hurst: float) -> Int64s:
    """Fractional Gaussian noise, exact by circulant embedding (Davies & Harte 1987)."""
    lags = np.arange(n + 1.0)
    covariances = (np.abs(lags + 1) ** (2 * hurst) + np.abs(lags - 1) ** (2 * hurst) - 2 * lags ** (2 * hurst)) / 2
    weights = np.sqrt(np.maximum(np.fft.fft(np.concatenate((covariances, covariances[-2:0:-1]))).real, 0) / (2 * n))
    return _normal(np.fft.fft(weights * (rng.normal(size=2 * n) + 1j * rng.normal(size=2 * n))).real[:n], p)


def periodic(n: int, p: float, rng: Rng) -> Int64s:
    values = quiet(n, rng)
    values[rng.integers(0, round(1 / p)) :: round(1 / p)] = MISS_NS
    return values


def mixture(n: int, p: float, rng: Rng) -> Int64s:
    """A load that comes and goes about every 50 loops; under it values are three times as wide and all misses occur."""
    loaded = np.cumsum(rng.random(n) < 1 / 50) % 2 == rng.integers(2)
    spread = (DEADLINE_NS - 50_000) / -math.log(2 * p)
    return (50_000 + rng.exponential(spread, n) * np.where(loaded, 1.0, 1 / 3)).astype(np.int64)


def late_regime(n: int, rng: Rng, *, p: float, part: float) -> Int64s:
    """No miss but in the last part of the run, where a loop misses with the chance p."""
    values = quiet(n, rng)
    tail = values[n - round(n * part) :]
    tail[rng.random(tail.size) < p] = MISS_NS
    return values


def rising(n: int, rng: Rng) -> Int64s:
    """No miss, but values grow by half from the first loop to the last, up to three quarters of the deadline."""
    return (quiet(n, rng) * np.linspace(2.0, 3.0, n)).astype(np.int64)


def around(middle_ns: Int64s | float, n: int, rng: Rng) -> Int64s:
    """Values within a few us of a middle, one or (n,)."""
    return (middle_ns + 1000 * rng.normal(size=n)).astype(np.int64)


def starting_up(
    n: int, p: float, rng: Rng, *, process: Process = independent, memory: int, times: float = 1.0, misses: float = 30.0
) -> Int64s:
    """A process whose values are so many times as high at first, and its misses so many times as frequent: p later on.

    Both fade by 1/e in so many loops (`memory`).
    """
    fades = np.exp(-np.arange(n) / memory)
    values = process(n, p, rng)
    values = np.where(values > DEADLINE_NS, values, np.minimum(values * (1 + (times - 1) * fades), 399_000))
    values[rng.random(n) < p * (misses - 1) * fades] = MISS_NS
    return values.astype(np.int64)


def heavy_tailed(n: int, p: float, rng: Rng) -> Int64s:
    """Independent values from a Pareto distribution without a mean."""
    return (DEADLINE_NS * p / (1 - rng.random(n))).astype(np.int64)


def regimes(pieces: int, n: int, rates: Callable[[int], float], rng: Rng) -> list[Int64s]:
    """So many runs of n loops, each with its own rate of misses."""
    return [independent(n, rates(piece), rng) for piece in range(pieces)]


def slow_load(n: int, p: float, rng: Rng, *, turn: int, regular: bool = True) -> Int64s:
    """A load that is there for `turn` loops (regular, else on average) and away for as many, begun anywhere.

    Under it all values are 60 us higher, and nearly all misses come; p is their rate in all.
    """
    phase = rng.integers(2 * turn)
    if regular:
        loaded = (np.arange(n) + phase) // turn % 2 == 0
    else:
        ends = np.cumsum(rng.exponential(turn, 8 + 4 * n // turn))
        loaded = np.searchsorted(ends, np.arange(n)) % 2 == phase % 2
    values = quiet(n, rng) + 60_000 * loaded
    values[rng.random(n) < p * np.where(loaded, 1.9, 0.1)] = MISS_NS
    return values


def boots(number: int, n: int, p: float, rng: Rng, *, spread: float) -> list[Int64s]:
    """One run a boot, n measurements in all; miss rates lognormal between boots with this spread and the mean p."""
    rates = p * np.exp(rng.normal(-(spread**2) / 2, spread, number))
    return [independent(n // number, min(1.0, rate), rng) for rate in rates]


def some_bad_boots(number: int, n: int, p: float, rng: Rng, *, one_in: int) -> list[Int64s]:
    """One run a boot of n measurements each; one boot in so many has nearly all misses, p is their rate in all."""
    rates = np.where(rng.random(number) < 1 / one_in, 0.95 * one_in * p, 0.05 * p)
    return [independent(n, rate, rng) for rate in rates]


DEPENDENT: dict[str, Process] = {
    "independent": independent,
    "moving average of 5": partial(moving_average, width=5),
    "AR(0.5)": partial(autoregressive, memory=0.5),
    "AR(0.9)": partial(autoregressive, memory=0.9),
    "AR(0.95)": partial(autoregressive, memory=0.95),
    "periodic": periodic,
    "load that comes and goes": mixture,
}
