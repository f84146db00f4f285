"""What tells one kind of measurement from another."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rtrun.analysis.histogram import Int64s
from rtrun.kinds.output import IndexedValues, Record
from rtrun.plan.question import Measure

Columns = Mapping[str, Int64s]


@dataclass(frozen=True, kw_only=True, slots=True)
class LogForm:
    """The logs that a suite wrote in 2014 and writes still, gnuplot scripts with the data in them.

    `main` is the series that the suite was about in 2014. `summary` is the line that says how many were asked for,
    `series` the series of a log by what its name ends with; `missing_as_value`: a missing message stands there as a
    value of -1 us.
    """

    suite: str
    main: str
    summary: re.Pattern[str]
    series: Mapping[str, str]
    missing_as_value: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasurementKind:
    """A kind of measurement.

    `series` makes the series of the samples from their columns, each of shape (rows,), the first of which is what the
    suite is about; it raises UsageError, which names the file, where rows and counts disagree. `called` says what a
    question calls a series; of two by one name the first in the samples is meant. `times` are the moments at which
    the values of a series were measured, int64 (n,).

    `subject` says in words what the values of a series are of, after its name: "of the timer".

    `startup` says of how many loops at the start of a run the values of a series stand apart, as in the thesis.
    `layer_below` is the baseline, or the kind, that measures what this one's values are on top of.

    `logs` is the form of its logs of 2014; None: there were none. `has_steps`: a value is on its way between two
    programs, and the steps of that can be told (causes/steps.py).
    """

    series: Callable[[Columns, Record, Path], dict[str, IndexedValues]]
    called: Mapping[str, Measure]
    times: Callable[[Columns, IndexedValues], Int64s]
    subject: str
    startup: Mapping[str, int] = field(default_factory=dict)
    layer_below: str = ""
    logs: LogForm | None = None
    has_steps: bool = False
