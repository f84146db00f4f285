"""What a deadline is compared with, and what counts as a miss. All other modules ask here.

A value above its deadline is late; a value equal to it is in time. A missing value is a miss, too: a message that never
came, a period that was skipped, a timer that did not fire, a call that never ended. A value that had not come at the
end is a miss once it has been open for longer than the deadline.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from rtfiles.errors import UsageError
from rtfiles.output import counted
from rtfiles.quantities import grouped

if TYPE_CHECKING:
    from rtrun.kinds.values import Bools, Int64s

Measure = Literal["latency", "lateness", "jitter", "duration", "interval", "reaction", "response", "age"]
"""What a suite measures."""
Of = Literal["lateness", "jitter"]
"""The values that a question may name. Lateness is how late something came that was due: a latency is a lateness."""
LATENESS: Of = "lateness"
JITTER: Of = "jitter"
# A missing value of these is a period without a call.
_OF_PERIODS: tuple[Measure, ...] = ("lateness", "response")


def judged(measures: Sequence[Measure], measure: Measure | None) -> Measure:
    """Which of these a question is about: what it names, or the first one; a latency is the lateness of its subject.

    Raises UsageError if the named one is not measured.
    """
    if measure is None or measure in measures:
        return measure or measures[0]
    if measure == LATENESS and "latency" in measures:
        return "latency"
    raise UsageError(f"measures {' and '.join(measures)}, not {measure}")


def first_late_ns(deadline_ns: int) -> int:
    """The lowest value that is late."""
    return deadline_ns + 1


def is_late(value_ns: int, deadline_ns: int) -> bool:
    """Whether a value is late."""
    return value_ns >= first_late_ns(deadline_ns)


def are_late(values_ns: "Int64s", deadline_ns: int, width_ns: "Int64s | int" = 1) -> "Bools":
    """Which values are late, shape (n,); for bins, given by lower edges and width, which may contain late values."""
    return values_ns >= first_late_ns(deadline_ns) - width_ns + 1


def absent_in_words(number: int, measure: Measure | None) -> str:
    """How many have no value: "3 periods skipped"."""
    return f"{counted(number, 'period')} skipped" if is_of_periods(measure) else f"{grouped(number)} never came"


def is_of_periods(measure: Measure | None) -> bool:
    """Whether a missing value is a period that was skipped, rather than something that was lost."""
    return measure in _OF_PERIODS
