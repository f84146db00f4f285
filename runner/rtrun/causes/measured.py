"""The values of a run with their times."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rtrun.kinds.lateness import JITTER, Measure, judged
from rtrun.kinds.values import Int64s
from rtrun.plan.suites import Value, kind_of, measures
from rtrun.plan.trace import SERIES
from rtrun.results.record import RunRecord, check_file
from rtrun.results.samples import read_samples


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Measured:
    """The values of an output, the index of each and its moment on the clock of the samples, all of shape (n,)."""

    output: str
    values_ns: Int64s
    index: Int64s
    times_ns: Int64s


def read_measured(folder: Path, record: RunRecord, measure: Measure | None = None) -> Iterator[Measured]:
    """Yield the outputs of a run that have samples with values; `measure` is the series, None: that of its traces.

    Raises UsageError as `read_samples` does, and if the suite does not measure that series.
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
        values = samples.judged(measure or traced_series(record.suite, record.parameters))
        if values.values_ns.size:
            times_ns = kind.times(samples.columns, values)
            yield Measured(output=output, values_ns=values.values_ns, index=values.index, times_ns=times_ns)


def traced_series(suite: str, parameters: Mapping[str, Value]) -> Measure:
    """The series that is compared with the limit of a trace; for the cyclic timer, the requested one."""
    return judged(measures(suite), JITTER if parameters.get(SERIES) == JITTER else None)
