"""The limit above which a run keeps traces. If the campaign gives a quantile, the warm-up shows the limit."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.causes.measured import read_measured
from rtrun.plan.run import Run
from rtrun.plan.suites import options
from rtrun.plan.trace import PARAMETER, WARM_UP, quantile, with_threshold
from rtrun.results.record import RunStatus, read_record


def with_threshold_of_warm_up(run: Run, results: Path) -> Run:
    """The run with its threshold, or unchanged if its limit needs no warm-up. Raises UsageError if that is missing."""
    part = quantile(run.trace)
    if part is None or run.subject.is_observed:
        return run
    allowed = options()[PARAMETER]
    threshold_us = round(_quantile_ns(results / f"{run.name}{WARM_UP}", part) / 1000)
    return with_threshold(run, max(allowed.min, min(threshold_us, allowed.max)))


def _quantile_ns(folder: Path, part: float) -> float:
    """The quantile of all values of a run. Raises UsageError when the run is not whole."""
    record = read_record(folder)
    if record.status is not RunStatus.OK:
        raise UsageError(f"{folder.name} is {record.status}: {record.reason}")
    values = [measured.values_ns for measured in read_measured(folder, record)]
    pooled = np.concatenate(values) if values else np.array([], dtype=np.int64)
    if not pooled.size:
        raise UsageError(f"{folder.name} measured nothing")
    return float(np.quantile(pooled, part))
