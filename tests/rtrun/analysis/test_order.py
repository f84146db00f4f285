"""The order of units is seen where it matters, and seldom where it does not."""

import numpy as np
import pytest

from rtrun.analysis.order.units_in_order import find_common_order, find_order


def shares_seen(draw, significant: float = 0.05, draws: int = 300) -> float:
    rng = np.random.default_rng(3)
    found = [draw(rng) for _ in range(draws)]
    return sum(order is not None and order.p_value < significant for order in found) / draws


@pytest.mark.parametrize("by_height", [True, False])
@pytest.mark.parametrize("sizes", [(5,), (20,), (3, 4, 5), (40, 2)])
def test_units_in_any_order_are_seldom_taken_for_a_trend(sizes: tuple[int, ...], by_height: bool) -> None:
    share = shares_seen(
        lambda rng: find_order([np.exp(2 * rng.normal(size=size)) for size in sizes], by_height=by_height)
    )
    assert share < 0.075, "5 %, but for what 300 draws do"


def test_a_climb_is_seen_however_steep_it_is() -> None:
    for steep in (0.1, 1, 10):
        order = find_order([np.exp(steep * np.arange(10))], by_height=False)
        assert order is not None and order.p_value < 0.002 and order.words("boots") == "in later boots"


def test_five_units_show_a_climb_and_four_cannot() -> None:
    five, four = (find_order([np.arange(size, dtype=float)], by_height=False) for size in (5, 4))
    assert five is not None and five.p_value < 0.03
    assert four is not None and four.p_value > 0.03


def test_short_climbs_of_many_boots_add_up() -> None:
    order = find_order([np.arange(3.0) + 10 * boot for boot in range(6)], by_height=False)
    assert order is not None and order.p_value < 0.002 and order.where == "rising"


def test_the_last_units_are_named() -> None:
    values = np.tile([0.0, 1.0], 20)
    values[-4:] = 50
    order = find_order([values], by_height=True)
    assert order is not None and order.p_value < 0.002 and order.words("runs") == "in the last 4 runs"


def test_what_does_not_differ_has_no_order() -> None:
    assert find_order([np.ones(10), np.empty(0)], by_height=True) is None
    assert find_common_order(np.zeros((5, 64))) is None
    assert find_common_order(np.eye(1, 64)) is None, "one run has no other to compare with"


def with_a_load(rng: np.random.Generator, runs: int) -> np.ndarray:
    """Runs that each have a load for a quarter of their time, somewhere."""
    counts = rng.poisson(0.5, (runs, 64)).astype(float)
    for row, start in zip(counts, rng.integers(0, 64, runs), strict=True):
        row[(start + np.arange(16)) % 64] += rng.poisson(8, 16)
    return counts


@pytest.mark.parametrize("runs", [2, 5, 30])
def test_a_load_in_each_run_is_no_common_order(runs: int) -> None:
    assert shares_seen(lambda rng: find_common_order(with_a_load(rng, runs)), draws=150) < 0.1


def test_a_leak_in_each_run_is_seen() -> None:
    def leak(rng: np.random.Generator):
        return find_common_order(rng.poisson(np.exp(np.linspace(-3, 1, 64)), (4, 64)).astype(float))

    assert shares_seen(leak, 0.01, draws=50) > 0.9
