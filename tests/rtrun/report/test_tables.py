"""Cells of the report's tables."""

import math

import pytest

from rtfiles.quantities import time_us


@pytest.mark.parametrize(
    ("value_ns", "text"),
    [(-3, "0.0"), (-51, "-0.1"), (1_234_567, "1235"), (-24_279_000, "-24279"), (None, "-"), (math.inf, "-")],
)
def test_a_time_in_us(value_ns, text):
    assert time_us(value_ns) == text
