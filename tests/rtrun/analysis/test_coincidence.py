"""Quantities that coincide with the highest values, on series whose truth is known."""

import numpy as np
import pytest

from rtrun.analysis.order.coincidence import ALPHA, LEAST_INTERVALS, find_coincidences

QUANTITIES = 10


def independent(random, n):
    return random.gamma(2.0, size=(QUANTITIES, n)), random.gamma(2.0, size=n)


def bursty(random, n):
    """Each depends on its own past, with events that last for several intervals."""

    def series():
        level = np.convolve(random.random(n + 4) < 0.03, np.ones(5), mode="valid")[:n]
        return random.normal(size=n) + 4 * level

    return np.array([series() for _ in range(QUANTITIES)]), series()


def drifting(random, n):
    """All rise over the run, and counts of zero are frequent."""
    rise = np.linspace(0, 5, n)
    counts = random.poisson(0.2, size=(QUANTITIES // 2, n))
    return np.vstack([random.normal(size=(QUANTITIES // 2, n)) + rise, counts]), random.normal(size=n) + rise


@pytest.mark.parametrize("draw", [independent, bursty, drifting])
def test_false_alarms_are_held_at_the_rate_for_all_quantities_together(draw, n=110):
    random = np.random.default_rng(n)
    alarms = sum(bool(find_coincidences(*draw(random, n))) for _ in range(100))
    # Of 100 runs one is expected; more than 6 have a probability of 0.01 %.
    assert alarms <= 6


@pytest.mark.parametrize("draw", [independent, bursty, drifting])
@pytest.mark.parametrize("sign", [1, -1])
def test_what_coincides_is_found(draw, sign):
    random = np.random.default_rng(3)
    quantities, highest = draw(random, 200)
    events = np.flatnonzero(random.random(200) < 0.08)
    highest[events] += 30
    quantities[7, events] += sign * 12
    found = find_coincidences(quantities, highest)
    assert found[0].row == 7
    assert found[0].p_value == pytest.approx(1 / 200) and found[0].p_value <= ALPHA
    assert np.sign(found[0].late - found[0].otherwise) == sign


def test_a_quantity_that_never_changes_and_few_intervals_say_nothing():
    random = np.random.default_rng(4)
    assert find_coincidences(np.ones((3, 200)), random.normal(size=200)) == ()
    assert find_coincidences(np.empty((0, 200)), random.normal(size=200)) == ()
    few = random.normal(size=LEAST_INTERVALS - 1)
    assert find_coincidences(few[None], few) == ()
