"""Times in the report: one rule for tables, sentences, axes, and what the page's script shows."""

import math

import pytest

from rtfiles.quantities import signed, time

TIMES = [
    (0, "0 us"),
    (-3, "-3 ns"),
    (44_500, "44.5 us"),
    (44_512, "44.51 us"),
    (400_000, "400 us"),
    (400_012, "400.0 us"),
    (999_960, "1.000 ms"),
    (92_066_000, "92.07 ms"),
    (-24_279_000, "-24.28 ms"),
    (1_500_000_000, "1.5 s"),
    (12_345_600_000_000, "12346 s"),
]


@pytest.mark.parametrize(("value_ns", "text"), [*TIMES, (None, "-"), (math.inf, "-")])
def test_a_time_has_the_unit_that_suits_it(value_ns, text):
    assert time(value_ns) == text


def test_a_difference_has_its_sign():
    assert [signed(value_ns) for value_ns in (1500, 0, -1500)] == ["+1.5 us", "+0 us", "-1.5 us"]
