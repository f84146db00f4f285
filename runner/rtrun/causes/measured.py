"""The values of a run with the moments at which they were measured."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtrun.analysis.histogram import Int64s
from rtrun.results.record import RunRecord, check_file
from rtrun.results.samples import IndexedValues, Samples, read_samples

# When a value was measured, by suite.
_TIMES = {
    "oneshot_timer_tests": "end_ns",
    "cyclic_timer_tests": "timestamp_ns",
    "communication_tests": "reception_ns",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Measured:
    """The values of an output, the index of each and its moment on the clock of the samples, all of shape (n,)."""

    output: str
    values_ns: Int64s
    index: Int64s
    times_ns: Int64s


def read_measured(folder: Path, record: RunRecord) -> Iterator[Measured]:
    """Yield the outputs of a run that have samples with values, by the series that its traces are of.

    Raises UsageError as `read_samples` does.
    """
    for output in dict.fromkeys(record.outputs):
        if record.suite not in _TIMES or f"{output}.npy" not in record.files:
            continue
        for ending in (".npy", ".json"):
            check_file(folder, record, output + ending)
        samples = read_samples(folder / f"{output}.npy")
        values = traced_values(samples)
        if values.values_ns.size:
            times_ns = _times(samples, values)
            yield Measured(output=output, values_ns=values.values_ns, index=values.index, times_ns=times_ns)


def traced_values(samples: Samples) -> IndexedValues:
    """The series that the limit of a trace is held against: of the cyclic timer what it was asked for."""
    of = samples.record.requested.get("trace_of")
    return samples.judged("jitter" if of == "jitter" else None)


def _times(samples: Samples, values: IndexedValues) -> Int64s:
    columns = samples.columns
    times = np.asarray(columns[_TIMES[samples.record.suite]])
    if "seq" in columns:
        # Messages are in the order of reception, their values in that of their numbers.
        _, order = np.unique(columns["seq"], return_index=True)
        return np.asarray(times[order])
    # The first row of a cyclic timer is the origin of the first period.
    return np.asarray(times[values.index + (1 if samples.record.suite == "cyclic_timer_tests" else 0)])
