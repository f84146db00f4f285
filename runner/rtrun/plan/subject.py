"""Whose programs a run measures."""

from dataclasses import dataclass
from typing import ClassVar

from rtrun.plan.observation import ObservationPlan
from rtrun.plan.topology.planning import TopologyPlan


@dataclass(frozen=True, slots=True)
class SuitePrograms:
    """The programs of the suite, which write down what they measure."""

    word: ClassVar[str] = ""
    is_observed: ClassVar[bool] = False
    makes_streams: ClassVar[bool] = False


Subject = SuitePrograms | ObservationPlan | TopologyPlan
"""The suite's programs, programs that are observed, or the nodes of a graph.

`word` is the subject's name in a campaign's digest and in JSON. If it `is_observed`, its programs do not measure. If
it `makes_streams`, the streams become runs next to the one that measured them.
"""
SUITE_PROGRAMS = SuitePrograms()
