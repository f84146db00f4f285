"""All kinds of measurement, by their names in suites.yml."""

from rtrun.kinds import (
    age,
    callback,
    cyclic,
    interval,
    loop,
    loop_response,
    messages,
    oneshot,
    path,
    response,
    service,
    timer,
)
from rtrun.kinds.kind import LogForm, MeasurementKind, StreamKind
from rtrun.kinds.lateness import Measure

KINDS: dict[str, MeasurementKind] = {
    "oneshot": oneshot.KIND,
    "cyclic": cyclic.KIND,
    "messages": messages.KIND,
    "timer": timer.KIND,
    "callback": callback.KIND,
    "service": service.KIND,
    "interval": interval.KIND,
    "path": path.KIND,
    "response": response.KIND,
    "age": age.KIND,
    "loop": loop.KIND,
    "loop-response": loop_response.KIND,
}
STREAMS: dict[str, StreamKind] = {kind.stream.word: kind.stream for kind in KINDS.values() if kind.stream}
"""The kinds of streams, by their words."""
LOGS: dict[str, LogForm] = {kind.logs.suite: kind.logs for kind in KINDS.values() if kind.logs}
"""The form of the logs of each suite that wrote logs in 2014."""
MAIN_2014 = frozenset(form.main for form in LOGS.values())
"""The series that the suites were about in 2014."""
MAIN_ONLY_IN_2014 = frozenset(
    kind.logs.main for kind in KINDS.values() if kind.logs and kind.logs.main != next(iter(kind.called))
)
"""Those of these series that today's suites are not about."""


CLUSTERED = {series: words for kind in KINDS.values() for series, words in kind.clustered.items()}
"""The series that may have a cluster of negative values, and what a report calls them."""


def startup_loops(series: str) -> int:
    """The number of loops at the start of a run whose values of a series are separated as start-up."""
    return next((kind.startup[series] for kind in KINDS.values() if series in kind.startup), 0)


def called(series: str) -> Measure | None:
    """What a question calls the series of this name; None if no question is about it."""
    return next((kind.called[series] for kind in KINDS.values() if series in kind.called), None)
