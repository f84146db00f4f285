"""The values of a run with the moments at which they were measured."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rtrun.analysis.histogram import Int64s
from rtrun.kinds.known import kind_of
from rtrun.kinds.output import IndexedValues
from rtrun.results.record import RunRecord, check_file
from rtrun.results.samples import Samples, read_samples


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
    kind = kind_of(record.suite)
    if kind is None:
        return
    for output in dict.fromkeys(record.outputs):
        if f"{output}.npy" not in record.files:
            continue
        for ending in (".npy", ".json"):
            check_file(folder, record, output + ending)
        samples = read_samples(folder / f"{output}.npy")
        values = traced_values(samples)
        if values.values_ns.size:
            times_ns = kind.times(samples.columns, values)
            yield Measured(output=output, values_ns=values.values_ns, index=values.index, times_ns=times_ns)


def traced_values(samples: Samples) -> IndexedValues:
    """The series that the limit of a trace is held against: of the cyclic timer what it was asked for."""
    of = samples.record.requested.get("trace_of")
    return samples.judged("jitter" if of == "jitter" else None)
