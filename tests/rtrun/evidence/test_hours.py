"""In how many hours of the day was measured."""

import pytest

from rtrun.evidence.hours import hours_measured
from rtrun.results.record import RunRecord


def run(start, end):
    return RunRecord.model_construct(start_time=start, end_time=end)


@pytest.mark.parametrize(
    ("start", "end", "hours"),
    [
        ("2026-01-01T10:59:00+00:00", "2026-01-01T10:59:30+00:00", 1),
        ("2026-01-01T10:59:00+00:00", "2026-01-01T11:00:30+00:00", 2),
        ("2026-01-01T23:30:00+00:00", "2026-01-02T01:30:00+00:00", 3),
        ("2026-01-01T10:30:00+00:00", "2026-01-02T10:10:00+00:00", 24),
        ("2026-01-01T10:30:00+00:00", "2026-01-09T10:10:00+00:00", 24),
        ("2026-01-01T12:30:00+02:00", "unknown", 1),
        # The clock was set back meanwhile.
        ("2026-01-01T10:30:00+00:00", "2026-01-01T09:10:00+00:00", 1),
        ("unknown", "unknown", None),
    ],
)
def test_the_hours_of_a_run(start, end, hours):
    assert hours_measured([run(start, end)]) == hours


def test_nights_of_a_week_are_the_same_hours():
    nights = [run(f"2026-01-{day:02}T02:10:00+00:00", f"2026-01-{day:02}T03:10:00+00:00") for day in range(1, 8)]
    assert hours_measured(nights) == 2
    assert hours_measured([*nights, run("2026-01-09T12:00:00+02:00", "2026-01-09T12:10:00+02:00")]) == 3
    assert hours_measured([]) is None
