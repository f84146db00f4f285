"""A one-shot timer: how long after it was armed its callback came."""

import re
from pathlib import Path

import numpy as np

from rtrun.kinds.kind import LogForm, MeasurementKind
from rtrun.kinds.rows import Columns, Stated, agree, check_times, times_in
from rtrun.kinds.values import IndexedValues

NOT_FIRED_NS = -(2**63)


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    fired = columns["measured_ns"] != NOT_FIRED_NS
    index = np.flatnonzero(fired)
    agree(path, "measured", len(index), stated.measured)
    agree(path, "not fired", len(fired) - len(index), stated.not_fired)
    start, armed = columns["start_ns"], columns["armed_ns"][index]
    measured, reported = columns["measured_ns"][index], columns["reported_ns"][index]
    check_times(path, start, columns["end_ns"][index], measured, reported, armed)
    # The programs of 2014 counted from after roscpp had armed the timer.
    measured_2014 = measured - (armed - start[index])
    values = {
        "measured": measured,
        "reported": reported,
        "difference": reported - measured,
        "measured_2014": measured_2014,
        "difference_2014": reported - measured_2014,
    }
    absent = np.flatnonzero(~fired)
    return {name: IndexedValues(values_ns=column, index=index, absent=absent) for name, column in values.items()}


KIND = MeasurementKind(
    series=_series,
    called={"measured": "latency", "measured_2014": "latency"},
    times=times_in("end_ns"),
    subject="of the timer",
    layer_below="cyclictest",
    logs=LogForm(
        suite="oneshot_timer_tests",
        main="measured_2014",
        summary=re.compile(r"with a loop length of ([0-9]{1,12}) "),
        series={"measured": "measured_2014", "reported": "reported", "diff": "difference_2014"},
        labels={"Measured:": "measured_2014", "Reported:": "reported", "Difference:": "difference_2014"},
    ),
)
