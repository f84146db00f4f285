"""The kinds of measurement that there are, by the names that suites.yml has for them."""

from rtrun.kinds import cyclic, messages, oneshot
from rtrun.kinds.kind import MeasurementKind
from rtrun.plan.question import Measure
from rtrun.plan.suites import suites

KINDS: dict[str, MeasurementKind] = {"oneshot": oneshot.KIND, "cyclic": cyclic.KIND, "messages": messages.KIND}
OF_2014: dict[str, MeasurementKind] = {kind.suite_2014: kind for kind in KINDS.values()}
"""The same by the suite whose logs had their form in 2014."""


def kind_of(suite: str) -> MeasurementKind | None:
    """The kind of a suite by its name; None for one that is not known, and for what writes no samples."""
    described = suites().suites.get(suite)
    return KINDS.get(described.kind) if described and described.kind else None


MAIN_2014 = frozenset(kind.main_2014 for kind in KINDS.values())
"""The series that the suites were about in 2014."""
ELSE_IN_2014 = frozenset(kind.main_2014 for kind in KINDS.values() if kind.main_2014 != next(iter(kind.called)))
"""Those of which today's suites are about another one."""


def startup_loops(series: str) -> int:
    """Of how many loops at the start of a run the values of a series stand apart."""
    return next((kind.startup[series] for kind in KINDS.values() if series in kind.startup), 0)


def called(series: str) -> Measure | None:
    """What a question calls a series by this name; None for one that no question is of."""
    return next((kind.called[series] for kind in KINDS.values() if series in kind.called), None)
