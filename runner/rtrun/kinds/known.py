"""The kinds of measurement that there are, by the names that suites.yml has for them."""

from rtrun.kinds import cyclic, interval, messages, oneshot, spans, timer
from rtrun.kinds.kind import LogForm, MeasurementKind
from rtrun.plan.question import Measure
from rtrun.plan.suites import find_suite

KINDS: dict[str, MeasurementKind] = {
    "oneshot": oneshot.KIND,
    "cyclic": cyclic.KIND,
    "messages": messages.KIND,
    "timer": timer.KIND,
    "callback": spans.CALLBACK,
    "interval": interval.KIND,
    "path": spans.PATH,
    "response": spans.RESPONSE,
    "age": spans.AGE,
}
LOGS: dict[str, LogForm] = {kind.logs.suite: kind.logs for kind in KINDS.values() if kind.logs}
"""The form of the logs of each suite that wrote some in 2014."""


def kind_of(suite: str) -> MeasurementKind | None:
    """The kind of a suite by its name; None for one that is not known, and for what writes no samples."""
    described = find_suite(suite)
    return KINDS.get(described.kind) if described and described.kind else None


MAIN_2014 = frozenset(form.main for form in LOGS.values())
"""The series that the suites were about in 2014."""
MAIN_ONLY_IN_2014 = frozenset(
    kind.logs.main for kind in KINDS.values() if kind.logs and kind.logs.main != next(iter(kind.called))
)
"""Those of which today's suites are about another one."""


def startup_loops(series: str) -> int:
    """Of how many loops at the start of a run the values of a series stand apart."""
    return next((kind.startup[series] for kind in KINDS.values() if series in kind.startup), 0)


def in_words(suite: str, series: str) -> str:
    """What the values of a series of a suite are: "lateness of the timer"."""
    kind = kind_of(suite)
    return f"{called(series) or series.replace('_', ' ')} {kind.subject if kind else f'by {suite}'}"


def called(series: str) -> Measure | None:
    """What a question calls a series by this name; None for one that no question is of."""
    return next((kind.called[series] for kind in KINDS.values() if series in kind.called), None)
