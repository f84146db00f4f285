"""Is a build worse than its history? Boots are the units of both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtrun.analysis.chance.distributions import beta_below, gamma_below, normal_quantile, student_quantile
from rtrun.analysis.dependence.design_effect import cluster_effect
from rtrun.analysis.order.change_points import Floats, levels

Boots = Sequence[tuple[int, int]]

LEAST_BOOTS = 5  # of a history
GATES_A_YEAR = 365
# The margin is at least so many spreads of a boot. With a smaller one, a year of gates has more false alarms than
# stated where boots drift or have a long upper tail: a test at 1 in 7300 extrapolates from some hundred boots
# (docs/archive.md).
LEAST_MARGIN = 2.0
# A boot may be bad in a rare way that the history has not shown yet. So a build is worse only if its other boots are
# worse, too. They are tested at a level of their own, because all boots together have already exceeded the limit for a
# year.
LEVEL_OF_OTHERS = 0.1
NOTICED = 0.9
# Rates of misses are taken to differ by at least so much from boot to boot (standard deviation). A history with hardly
# any miss would show no difference.
_RATES_DIFFER = 0.6


@dataclass(frozen=True, kw_only=True, slots=True)
class Against:
    """A figure of a build against its history, in the unit of the figure.

    `reference` is the mean of the history's best level, over `boots` boots; `value` is the build's mean. A build that
    is worse than the reference by at most the margin exceeds `limit` with at most the chance of the test's level. A
    build whose true figure is at least `noticed` exceeds it nine times in ten. `others_too`: the boots without the
    worst one also exceed their limit, at LEVEL_OF_OTHERS; false for a single boot, where this is not known.
    """

    reference: float
    boots: int
    value: float
    limit: float
    noticed: float
    others_too: bool

    @property
    def exceeds(self) -> bool:
        """Whether the build, or one bad boot of it, is worse than its history by more than the margin."""
        return self.value > self.limit

    @property
    def worse(self) -> bool:
        """Whether the build is worse by more than the margin, and not because of one bad boot."""
        return self.exceeds and self.others_too


def level_of_test(false_alarms: float, tests: int) -> float:
    """The level of each of `tests` tests of a gate: in a year of daily gates without a change, the chance of any false
    alarm is then at most `false_alarms` (Bonferroni)."""
    return false_alarms / (GATES_A_YEAR * tests)


def best_level(history: Floats) -> tuple[Floats, float]:
    """The lowest level between the change points of a history (u,), among levels of at least LEAST_BOOTS boots.

    Thus a build that made things worse does not become the reference of the next builds. The second value is the
    standard deviation of boots within all levels, because the few boots of one level may lie close together by chance.
    """
    stretches = [history[stretch] for stretch in levels(history)]
    squares = sum(float(((level - level.mean()) ** 2).sum()) for level in stretches)
    within = math.sqrt(squares / (history.size - len(stretches)))
    long = [level for level in stretches if level.size >= LEAST_BOOTS]
    return min(long, key=lambda level: float(level.mean()), default=history), within


def compare_figure(
    history: Floats, build: Floats, *, level: float, margin: float | None, share: float = 0.0, least: float = 0.0
) -> Against:
    """Compare boots of a build (k,) with those of its history (u,), LEAST_BOOTS at least: lower is better.

    The default margin is a `share` of the reference, but at least `least`. Any margin is raised to LEAST_MARGIN spreads
    of a boot.

    The limit predicts the mean of k boots by Student's t, with a tail as heavy as the kurtosis of the reference: a t
    distribution with v degrees of freedom has the excess kurtosis 6 / (v - 4). The spread is the largest of three: that
    of the reference, that of its values above the median (so that a long upper tail counts in full), and that within
    all levels.
    """
    reference, within = best_level(history)
    mean = float(reference.mean())
    spread, degrees = _spread(reference)
    spread = max(spread, within)
    allowed = max(LEAST_MARGIN * spread, max(least, share * abs(mean)) if margin is None else margin)
    limit = mean + allowed + _reach(reference.size, build.size, spread, degrees, level)
    others = np.sort(build)[:-1]
    return Against(
        reference=mean,
        boots=reference.size,
        value=float(build.mean()),
        limit=limit,
        noticed=limit + normal_quantile(NOTICED) * spread / math.sqrt(build.size),
        others_too=others.size > 0
        and float(others.mean())
        > mean + allowed + _reach(reference.size, others.size, spread, degrees, LEVEL_OF_OTHERS),
    )


def _reach(old: int, new: int, spread: float, degrees: float, level: float) -> float:
    """How far the mean of `new` boots may lie above that of `old` ones: it exceeds this with the chance `level`."""
    return student_quantile(1 - level, degrees) * spread * math.sqrt(1 / new + 1 / old)


def _spread(reference: Floats) -> tuple[float, float]:
    """Spread of one boot, and the degrees of freedom of a t distribution that has its tail."""
    around = reference - float(reference.mean())
    variance = float((around**2).sum()) / (reference.size - 1)
    if variance == 0:
        return 0.0, float(reference.size - 1)
    from_median = reference - float(np.median(reference))
    upper = from_median[from_median > 0]
    one_sided = float((upper**2).sum()) * 2 / reference.size
    excess = float((around**4).mean()) / float((around**2).mean()) ** 2 - 3
    tail = 4 + 6 / excess if excess > 0 else math.inf
    return math.sqrt(max(variance, one_sided)), min(float(reference.size - 1), tail)


def compare_misses(history: Boots, build: Boots, *, level: float) -> Against:
    """Compare P(miss) of a build with its history, from (measurements, misses) of each boot; the figure is P(miss).

    The build is worse where both hold: its share exceeds the limit for the shares of boots (`compare_figure`), and the
    chance of its misses is below the level. The second matters if the history has hardly any miss. For the chance of
    the other boots, the worst boot counts as history, so a second burst like its own is not a surprise.
    """
    against = compare_figure(_shares(history), _shares(build), margin=0.0, level=level)
    *others, worst = sorted(build, key=lambda boot: boot[1] / boot[0])
    measured = sum(n for n, _ in build)
    # The fewest misses that are too many by both tests.
    few, many = 0, measured + 1
    while many - few > 1:
        middle = (few + many) // 2
        enough = middle > against.limit * measured and chance_of_misses(history, [(measured, middle)]) < level
        few, many = (few, middle) if enough else (middle, many)
    return replace(
        against,
        limit=max(against.limit, few / measured),
        noticed=_share_noticed(many, history, build),
        others_too=against.others_too and chance_of_misses([*history, worst], others) < LEVEL_OF_OTHERS,
    )


def _shares(boots: Boots) -> Floats:
    return np.array([misses / n for n, misses in boots])


def _share_noticed(least: int, history: Boots, build: Boots) -> float:
    """The share of misses at which such a build has at least `least` misses nine times in ten; 1 if none is known.

    Numbers divided by the design effect are Poisson distributed. The rates of boots scatter in proportion to their
    mean, so the design effect minus 1 is proportional to the share.
    """
    measured = sum(n for n, _ in build)
    share = sum(misses for _, misses in history) / sum(n for n, _ in history)
    more = (cluster_effect(history) - 1) / share if share else 0.0
    more = max(more, _RATES_DIFFER**2 * measured / len(build))
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        effect = 1 + more * middle
        low, high = (
            (low, middle) if gamma_below(measured * middle / effect, least / effect) >= NOTICED else (middle, high)
        )
    return high


def chance_of_misses(history: Boots, build: Boots) -> float:
    """The chance, given the sum of all misses, that at least so many are the build's (Przyborowski & Wilenski 1940).

    The numbers, (measurements, misses) of each boot, are divided by the design effect of boots (Rao & Scott 1992).
    """
    effect = max(1.0, cluster_effect(history))
    n_a, k_a = (sum(numbers) / effect for numbers in zip(*history, strict=True))
    n_b, k_b = (sum(numbers) / effect for numbers in zip(*build, strict=True))
    return beta_below(n_b / (n_a + n_b), k_b, k_a + 1) if k_b else 1.0
