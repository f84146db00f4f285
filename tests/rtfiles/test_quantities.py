"""Shares in words: what is asked is exact, a bound never says less than it is."""

import math
import random

import pytest

from rtfiles.quantities import at_least_in, at_most_in, between, one_in, percent_at_most, rounded_down, rounded_up


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1e-2, "1 in 100"),
        (1e-6, "1 in a million"),
        (2.5e-3, "25 in 10 000"),
        (0.5, "5 in 10"),
        (1.5e-7, "15 in 100 million"),
        (1e-9, "1 in a billion"),
        (3e-12, "3 in 1 000 billion"),
    ],
)
def test_what_is_asked_is_exact(share: float, text: str) -> None:
    assert one_in(share) == text


@pytest.mark.parametrize(
    ("share", "most", "least"),
    [
        (0.0041, "5 in 1 000", "4 in 1 000"),
        (0.0011, "11 in 10 000", "11 in 10 000"),
        (0.01, "1 in 100", "1 in 100"),
        (0.95, "all", "9 in 10"),
        (1.0, "all", "all"),
        (9.99e-4, "1 in 1 000", "9 in 10 000"),
    ],
)
def test_a_bound_is_rounded_away_from_what_it_excludes(share: float, most: str, least: str) -> None:
    assert (at_most_in(share), at_least_in(share)) == (most, least)


def value_of(text: str) -> float:
    number, _, size = text.partition(" in ")
    words = {"a million": 1e6, "a billion": 1e9}
    scale = 1e9 if size.endswith("billion") else 1e6 if size.endswith("million") else 1.0
    digits = "".join(filter(str.isdigit, size))
    return int(number) / words.get(size, float(digits or 1) * scale)


def test_no_share_is_rounded_to_the_wrong_side_or_by_more_than_a_third() -> None:
    draw = random.Random(1)
    for _ in range(2000):
        share = math.exp(draw.uniform(math.log(1e-11), math.log(0.9)))
        most, least = value_of(at_most_in(share)), value_of(at_least_in(share))
        assert least <= share * (1 + 1e-8) and share * (1 - 1e-8) <= most, share
        assert float(rounded_down(share)) <= share * (1 + 1e-8) and share * (1 - 1e-8) <= float(rounded_up(share))
        assert most <= share * 4 / 3 + 1e-15 and least >= share * 2 / 3, share


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [(0.00168, 0.0168, "0.0016 to 0.017"), (0.2, 0.2, "0.2 to 0.2"), (0.0, 0.9999, "0 to 1")],
)
def test_an_interval_is_never_narrower_than_it_is(low: float, high: float, text: str) -> None:
    assert between(low, high) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.5218, "53 %"),
        (0.05, "5 %"),
        (0.0499, "5 %"),
        (0.0, "0 %"),
        (0.975, "98 %"),
        (0.98741, "98.75 %"),
        (1.0, "100 %"),
    ],
)
def test_a_share_that_is_a_bound_is_never_lower_than_it_is(share: float, text: str) -> None:
    assert percent_at_most(share) == text
