"""What counts as a miss, and that one module alone decides it."""

import re
from pathlib import Path

import numpy as np
import pytest

import rtrun
from rtfiles.errors import UsageError
from rtrun.kinds.lateness import absent_in_words, are_late, is_late, judged

TOP = Path(rtrun.__file__).parent
# Comparisons of an array, or of a value, with a deadline.
COMPARED = re.compile(r"(?:values?|lengths|heights|every|open)(?:_ns)? *(?:>|<=) *[a-z_.]*deadline_ns")


def test_a_value_above_its_deadline_is_late_and_one_that_equals_it_is_not():
    assert [is_late(value, 400) for value in (399, 400, 401)] == [False, False, True]
    assert are_late(np.array([399, 400, 401]), 400).tolist() == [False, False, True]


def test_what_may_be_late_is():
    edges = np.array([301, 302, 400, 401])
    assert are_late(edges, 400, 100).tolist() == [False, True, True, True]
    assert are_late(edges, 400, np.array([100, 99, 1, 1])).tolist() == [False, False, False, True]


def test_a_latency_is_the_lateness_of_its_subject():
    assert judged(("lateness", "jitter"), None) == "lateness"
    assert judged(("lateness", "jitter"), "jitter") == "jitter"
    assert judged(("latency",), "lateness") == "latency"
    with pytest.raises(UsageError, match="measures latency, not jitter"):
        judged(("latency",), "jitter")


def test_what_is_absent_in_words():
    assert absent_in_words(1, "lateness") == "1 period skipped"
    assert absent_in_words(3, "latency") == "3 never came"


def test_no_other_module_compares_values_with_a_deadline():
    found = [
        str(path.relative_to(TOP))
        for path in TOP.rglob("*.py")
        if COMPARED.search(path.read_text()) and path.name != "lateness.py"
    ]
    assert found == []
    assert COMPARED.search("late = values_ns > deadline_ns")
