"""Which values of a run get a kernel trace: `trace` of a campaign, and the additional runs that it needs.

A traced run has a twin without traces, which shows what tracing costs; the two alternate. If the limit is a quantile, a
short warm-up before the run finds it. The warm-up records the same events, so its values are those of a traced run.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

from rtfiles.config import Config, Place, parse
from rtfiles.errors import UsageError
from rtrun.plan.quantities import read_time_ns
from rtrun.plan.run import UNTRACED, Run, never_observed
from rtrun.plan.suites import Value, options

PARAMETER = "trace_threshold_us"
SERIES = "trace_of"
WARM_UP = ".warm-up"
# This many values of a warm-up are expected above the quantile, and at least one of the run.
VALUES_ABOVE = 10
_QUANTILE = re.compile(r"p([0-9]{2}(?:\.[0-9]{1,6})?)", re.ASCII)


class TraceSetting(Config):
    """`trace` of a campaign."""

    above: str


def read_trace(value: object, where: Place) -> str:
    """Return `above` in canonical form: a whole number of microseconds as ``300us``, or a quantile as ``p99.9``.

    Raises UsageError. A run without `trace` has an empty text.
    """
    if value is None:
        return ""
    above = parse(value, TraceSetting, where).above
    if (match := _QUANTILE.fullmatch(above)) and 50 <= float(match[1]) < 100:
        return f"p{float(match[1]):.8g}"
    allowed = options()[PARAMETER]
    try:
        microseconds, rest = divmod(read_time_ns(above), 1000)
    except ValueError:
        microseconds, rest = 0, 1
    if rest or not allowed.min <= microseconds <= allowed.max:
        raise UsageError(
            f"{where / 'above'}: takes a time in whole microseconds up to {allowed.max // 10**6}s, as 300us, or a "
            f"quantile from p50 up, as p99.9; got {above!r}"
        )
    return f"{microseconds}us"


def quantile(trace: str) -> float | None:
    """The quantile as a part of 1; None if the limit is a time or there is no limit."""
    return float(trace[1:]) / 100 if trace.startswith("p") else None


def traced(run: Run) -> tuple[Run, ...]:
    """A run that keeps traces and its twin that does not, in alternating order; or only the run if it keeps none.

    If the limit is a quantile, the threshold is not known yet.
    """
    if not run.trace:
        return (run,)
    if run.subject.is_observed:
        # An observation finds its limit while it lasts.
        pair = (replace(run, trace=UNTRACED), run)
        return pair if run.repeat % 2 else pair[::-1]
    known = None if quantile(run.trace) is not None else int(run.trace.removesuffix("us"))
    pair = (replace(run, trace=UNTRACED), with_threshold(run, known))
    return pair if run.repeat % 2 else pair[::-1]


def with_threshold(run: Run, threshold_us: Value) -> Run:
    """A run that keeps the traces of values above a threshold."""
    return replace(run, parameters={**run.parameters, PARAMETER: threshold_us})


def with_warm_ups(runs: Iterable[Run]) -> Iterator[Run]:
    """Yield the runs in their order; before a run whose limit is a quantile comes its warm-up, `<name>.warm-up`."""
    for run in runs:
        if quantile(run.trace) is not None and not run.subject.is_observed:
            yield _warm_up(run)
        yield run


def _warm_up(run: Run) -> Run:
    """A short run that records like a traced one but keeps no trace; as long as the run if a shorter one would be
    invalid."""
    number = min(_repetitions(run), math.ceil(VALUES_ABOVE / _above(run)))
    alike = replace(with_threshold(run, options()[PARAMETER].max), name=f"{run.name}{WARM_UP}", trace="")
    short = replace(alike, parameters={**alike.parameters, "repetitions": number})
    return alike if never_observed(short) else short


def too_few(run: Run) -> str | None:
    """Say why a run is too short for its quantile, or None."""
    if quantile(run.trace) is None or run.subject.is_observed or _repetitions(run) * _above(run) >= 1:
        return None
    return (
        f"{run.suite} measures {_repetitions(run)} values; none is expected above {run.trace}: "
        f"trace.above takes repetitions of {math.ceil(1 / _above(run))} or more for it"
    )


def _above(run: Run) -> float:
    """The share of values that is expected above the quantile."""
    return round(1 - (quantile(run.trace) or 0.0), 9)


def _repetitions(run: Run) -> int:
    return int(run.parameters.get("repetitions") or 0)
