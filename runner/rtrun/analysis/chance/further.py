"""How many measurements decide a question: planned beforehand, and predicted from what was seen so far."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rtrun.analysis.chance.distributions import beta_above, beta_below, poisson_quantile
from rtrun.analysis.chance.intervals import anytime_lower, anytime_upper, is_upper_below, of_few
from rtrun.analysis.chance.search import where_one
from rtrun.plan.question import Question, bursts_asked

# No plan has more measurements than this: at 1 kHz they take 30 000 years.
UNATTAINABLE = 10**15
# "Nine times in ten".
LIKELY = 0.9
SEED = 20140715
_COURSES = 1000
# How many future bursts are simulated. A question that these do not decide is not decided soon.
_BURSTS_TO_COME = 200


def longest_burst(misses: float, n: float, effect: float, question: Question) -> float:
    """The longest mean length of unseen bursts of misses for which n measurements are still a proof; 0 if they are
    none.

    P(miss) has two parts: misses of the kind seen, whose upper end is `anytime_upper`, and unseen bursts, at the rate
    at which n measurements contain none with the chance 1 - confidence. If misses were seen, each part gets half of
    that chance.
    """
    if n <= 0 or not is_upper_below(misses / effect, n / effect, question.confidence, question.probability):
        return 0.0
    confidence = (1 + question.confidence) / 2 if misses else question.confidence
    seen = anytime_upper(misses / effect, n / effect, confidence) if misses else 0.0
    return max(1.0, (question.probability - seen) / anytime_upper(0, n, confidence))


def proves(misses: float, n: float, effect: float, question: Question) -> bool:
    """Whether the upper end of P(miss) is below the target, including the bursts that have to be covered."""
    if (bursts := bursts_asked(question).length) > 1:
        return longest_burst(misses, n, effect, question) >= bursts
    return n > 0 and is_upper_below(misses / effect, n / effect, question.confidence, question.probability)


def missing_without_miss(misses: float, n: int, effect: float, question: Question) -> int | None:
    """How many more measurements without another miss are a proof; None if no number is."""
    total = smallest(lambda total: proves(misses, total, effect, question), n)
    return None if total is None else total - n


def chance_of_no_miss(misses: float, n: int, effect: float, more: int) -> float:
    """The chance that so many more measurements hold no miss, given what was seen.

    The rate of misses is gamma distributed after Jeffreys' prior for a Poisson rate (Gelman et al. 2013, section 2.6).
    """
    return float((n / (n + more)) ** (misses / effect + 0.5)) if n else 0.0


def plan_measurements(
    question: Question, *, rate: float = 0.0, period_ns: float | None = None
) -> tuple[bool, int] | None:
    """Plan for a proof (True) or a refutation, and how many independent measurements suffice nine times in ten.

    `rate` is the rate of misses; if it is 0, the result is the smallest number that proves. `period_ns` is the period
    of the stream; a proof covers a stall of it (`bursts_asked`). Where misses are tolerated, each end of a window is a
    measurement, and overlapping windows are worth one. None where no number decides.
    """
    asked, bursts = question.confidence, bursts_asked(question, period_ns).length
    question = replace(question, bursts=bursts, confidence=of_few(asked, question.boots))
    effect = float(question.tolerance.overlap)
    if not rate:
        total = smallest(lambda total: proves(0, total, effect, question), 0)
        return None if total is None else (True, total)

    def decided(total: int) -> bool:
        # The unfavourable number of misses (Poisson): many for a proof, few for a refutation.
        if rate < question.probability:
            misses = effect * poisson_quantile(LIKELY, rate * total / effect)
            return proves(misses, total, effect, question)
        misses = max(0, poisson_quantile(1 - LIKELY, rate * total / effect) - 1)
        return anytime_lower(misses, total / effect, asked) > question.probability

    total = smallest(decided, 0)
    return None if total is None else (rate < question.probability, total)


def plan_groups(
    question: Question, periods_ns: Mapping[str, float | None], *, rate: float = 0.0
) -> tuple[bool, dict[str, int]] | None:
    """`plan_measurements` for several groups, by name; None where no number decides one of them."""
    planned = {name: plan_measurements(question, rate=rate, period_ns=period) for name, period in periods_ns.items()}
    decided = {name: plan for name, plan in planned.items() if plan is not None}
    if len(decided) < len(planned):
        return None
    return all(is_proven for is_proven, _ in decided.values()), {name: total for name, (_, total) in decided.items()}


def likely_further(misses: float, n: int, effect: float, question: Question) -> tuple[bool, int] | None:
    """Predict a proof (True) or a refutation, and how many more measurements suffice nine times in ten.

    Courses of future misses are simulated at rates drawn from what was seen (Jeffreys' prior for a Poisson rate, Gelman
    et al. 2013, section 2.6). The question is examined after every measurement, and a course ends when it is decided.
    None if at least a tenth of the courses is not decided soon.
    """
    if not n or not misses:
        return None
    k, scale = misses / effect, 1 / effect
    rng = np.random.default_rng(SEED)
    rates = rng.gamma(k + 0.5, 1 / (n * scale), _COURSES)
    # When each future burst arrives, in effective measurements from the very first one.
    arrivals = n * scale + np.cumsum(rng.exponential(size=(_COURSES, _BURSTS_TO_COME)), axis=1) / rates[:, None]
    before = np.column_stack((np.full(_COURSES, n * scale), arrivals[:, :-1]))
    counts = [k + more for more in range(_BURSTS_TO_COME + 1)]
    first, likely = np.full(_COURSES, np.inf), np.inf
    ends = zip(_proven_from(counts[:-1], effect, question), _refuted_until(counts[1:], question), strict=True)
    for begin, arrival, (proven_from, refuted_until) in zip(before.T, arrivals.T, ends, strict=True):
        proven = np.where(proven_from < arrival, np.maximum(proven_from, begin), np.inf)
        refuted = np.where(arrival <= refuted_until, arrival, np.inf)
        first = np.minimum(first, np.minimum(proven, refuted))
        likely = float(np.quantile(first, LIKELY, method="higher"))
        # A course that is still undecided is decided at this arrival or later.
        if likely <= arrival[np.isinf(first)].min(initial=np.inf):
            break
    total = likely * effect
    if not total < UNATTAINABLE:
        return None
    return misses / n < question.probability, max(0, math.ceil(total) - n)


def _proven_from(counts: Sequence[float], effect: float, question: Question) -> Iterator[float]:
    """For each number of bursts, the effective measurements from which on they are a proof (`longest_burst`)."""
    bursts = bursts_asked(question).length
    several = bursts > 1
    alpha = (1 - question.confidence) / (2 if several else 1)
    at = 0.0
    for count in counts:
        whole = math.ceil(count - 1e-9)
        level = alpha / ((whole + 1) * (whole + 2))

        def how_near(log_more: float, count: float = count, level: float = level) -> float:
            total = count + math.exp(log_more)
            unseen = -math.expm1(math.log(alpha / 2) / (total * effect)) if several else 0.0
            target = max(question.probability - bursts * unseen, 0.0)
            # The interval ends below the target if, at the target's rate, so few misses have a chance below the level.
            return level / max(beta_above(target, count + 1, total - count), 1e-300)

        at = where_one(how_near, at or math.log((count + 1) / question.probability))
        yield count + math.exp(at)


def _refuted_until(counts: Sequence[float], question: Question) -> Iterator[float]:
    """For each number of bursts, the effective measurements up to which they are a refutation."""
    at = 0.0
    for count in counts:
        whole = max(1, math.ceil(count - 1e-9))
        level = (1 - question.confidence) / (whole * (whole + 1))
        if question.probability**count >= level:
            yield count  # if all measurements are misses, these are still too few
            continue

        def how_near(log_more: float, count: float = count, level: float = level) -> float:
            return beta_below(question.probability, count, math.exp(log_more) + 1) / level

        at = where_one(how_near, at or math.log(count / question.probability))
        yield count + math.exp(at)


def smallest(condition: Callable[[int], bool], start: int) -> int | None:
    """The smallest number from `start` on for which a monotone condition holds; None above UNATTAINABLE."""
    if start and condition(start):
        return start
    low, high = start, max(1, start)
    while not condition(high):
        low, high = high, 2 * high
        if high > UNATTAINABLE:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if condition(middle) else (middle, high)
    return high
