"""Intervals of a probability: exact for one look at the data, or valid however often somebody looks."""

import math

from rtrun.analysis.chance.distributions import beta_above, beta_below, beta_exceeded, beta_quantile

# Boots.
FEW = 9


def clopper_pearson(k: float, n: float, confidence: float) -> tuple[float, float]:
    """The exact two-sided interval of a probability after k events in n trials (Clopper & Pearson 1934).

    k and n need not be whole: with effective numbers this is the interval of Korn & Graubard (1998) for dependent
    trials. No trial gives (0, 1).
    """
    tail = (1 - confidence) / 2
    return lower_bound(k, n, tail), upper_bound(k, n, tail)


def anytime_interval(k: float, n: float, confidence: float) -> tuple[float, float]:
    """The interval of a probability after k events in n trials that holds however often somebody looks.

    With alpha = 1 - confidence, the upper end is that of Clopper & Pearson at level alpha / ((k + 1)(k + 2)), the lower
    one at alpha / (k (k + 1)). Both sum to alpha over k. With k events, the upper end first falls below p at a fixed
    n(k). This is wrong only if n(k) trials had at most k events, and the chance of that is the level of k. So the
    chance of ever being wrong is at most alpha (union bound), and alpha / 2 for one look at a fixed n. The same holds
    for the lower end. Fractions of events (effective numbers) are rounded up to choose the level.
    """
    return anytime_lower(k, n, confidence), anytime_upper(k, n, confidence)


def anytime_lower(k: float, n: float, confidence: float) -> float:
    """The lower end of `anytime_interval`."""
    whole = max(1, math.ceil(k - 1e-9))
    return lower_bound(k, n, (1 - confidence) / (whole * (whole + 1)))


def anytime_upper(k: float, n: float, confidence: float) -> float:
    """The upper end of `anytime_interval`."""
    return upper_bound(k, n, _upper_level(k, confidence))


def of_few(confidence: float, boots: int) -> float:
    """The stricter confidence of an upper end from boots that are too few to show how much boots differ.

    Two to nine boots that are alike by chance hide that boots differ, and no interval shows it. If P(miss) of boots is
    lognormal (sd 1), the truth exceeds a 95 % bound without a miss in 12 % of all cases with two boots, and in 7 % with
    five. At half of alpha it does so in 5 %; two boots need a tenth of alpha. One boot says nothing about others, so
    its interval is not widened.
    """
    return 1 - (1 - confidence) / (1 if boots < 2 or boots > FEW else 10 if boots == 2 else 2)


def is_upper_below(k: float, n: float, confidence: float, p: float) -> bool:
    """Whether `anytime_upper` is below p. Ten times as fast, because it does not compute the bound."""
    if not 0 < k < n:
        return anytime_upper(k, n, confidence) < p
    return beta_above(p, k + 1, n - k) < _upper_level(k, confidence)


def chance_of_so_many(k: float, n: float, p: float) -> float:
    """The chance of k or more events in n trials of probability p; k and n need not be whole."""
    return 1.0 if k <= 0 or n <= 0 else beta_below(p, min(k, n), max(n - k, 0.0) + 1)


def lower_bound(k: float, n: float, level: float) -> float:
    """The probability at which k or more events in n trials have the chance `level`; 0 when k is 0."""
    return 0.0 if k <= 0 or n <= 0 else beta_quantile(level, min(k, n), max(n - k, 0.0) + 1)


def upper_bound(k: float, n: float, level: float) -> float:
    """The probability at which k or fewer events in n trials have the chance `level`; 1 when k is n."""
    if n <= 0 or k >= n:
        return 1.0
    # For k = 0 the closed form keeps every digit where 1 - x would lose them.
    return -math.expm1(math.log(level) / n) if k <= 0 else beta_exceeded(level, k + 1, n - k)


def _upper_level(k: float, confidence: float) -> float:
    whole = math.ceil(k - 1e-9)
    return (1 - confidence) / ((whole + 1) * (whole + 2))
