"""Runs at 1 kHz in us, with late values at a period, or dependent in other ways and without one."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from rtrun.analysis.order.recurrence import counts_tried, find_recurrence

Floats = NDArray[np.float64]
Rng = np.random.Generator


def independent(n: int, rng: Rng) -> Floats:
    return 38 + 7 * rng.gamma(3, size=n)


def periodic(n: int, rng: Rng, *, period: int) -> Floats:
    """One late value a period, with a jitter of 0.2 % of it; from 20 periods on one in ten is missing."""
    values = independent(n, rng)
    exact = np.arange(rng.random() * period, n, period)
    times = (exact + rng.normal(0, 0.002 * period, exact.size)).astype(int)
    if times.size >= 20:
        times = times[rng.random(times.size) >= 0.1]
    values[times[(times >= 0) & (times < n)]] += rng.normal(600, 20)
    return values


def autoregressive(n: int, rng: Rng, *, memory: float) -> Floats:
    return np.asarray(lfilter([1], [1, -memory], rng.normal(size=n + 5000))[5000:])


def bursts(n: int, rng: Rng, *, length: int) -> Floats:
    """One value in a hundred is late, in bursts of this mean length."""
    values, number = independent(n, rng), rng.poisson(n / 100 / length)
    for start, size in zip(rng.integers(0, n, number), rng.geometric(1 / length, number), strict=True):
        values[start : start + size] += 300
    return values


def loose_bursts(n: int, rng: Rng) -> Floats:
    """Twenty times half a second with six late values anywhere in it."""
    values = independent(n, rng)
    places = rng.integers(0, n, 20)[:, None] + rng.integers(0, 500, (20, 6))
    values[places.ravel() % n] += rng.normal(300, 50, 120)
    return values


def modulated(n: int, rng: Rng) -> Floats:
    """Values whose width goes up and down over seconds."""
    return independent(n, rng) * np.exp(autoregressive(n, rng, memory=0.999) / 50)


def heavy(n: int, rng: Rng) -> Floats:
    return rng.standard_t(2, size=n)


def drifting(n: int, rng: Rng) -> Floats:
    return independent(n, rng) * np.linspace(1.0, 1.5, n)


def random_walk(n: int, rng: Rng) -> Floats:
    return independent(n, rng) + 0.05 * np.cumsum(rng.normal(size=n))


def late_tenth(n: int, rng: Rng) -> Floats:
    return independent(n, rng) + 60 * (np.arange(n) >= n * 9 // 10)


WITHOUT_PERIOD: dict[str, Callable[[int, Rng], Floats]] = {
    "independent": independent,
    "AR(0.9)": partial(autoregressive, memory=0.9),
    "AR(0.99)": partial(autoregressive, memory=0.99),
    "AR(0.999)": partial(autoregressive, memory=0.999),
    "bursts of 5": partial(bursts, length=5),
    "bursts of 100": partial(bursts, length=100),
    "loose bursts of half a second": loose_bursts,
    "width that goes up and down": modulated,
    "heavy tail": heavy,
    "drift": drifting,
    "random walk": random_walk,
    "the last tenth late": late_tenth,
}


def period_of(values: Floats) -> float | None:
    """The period in loops that `rtrun why` would find."""
    highest = np.argsort(-values)[: max(counts_tried(values.size))]
    found = find_recurrence(highest, begin=0, end=values.size, values=values.size, searches=2)
    return found.period if found else None


def is_found(n: int, period: int, rng: Rng) -> bool:
    """Whether it finds the period there is, to 1 %."""
    found = period_of(periodic(n, rng, period=period))
    return found is not None and abs(found / period - 1) < 0.01


def finds_one(n: int, make: Callable[[int, Rng], Floats], rng: Rng) -> bool:
    """Whether it finds a period where there is none."""
    return period_of(make(n, rng)) is not None
