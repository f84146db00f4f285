"""The module of each subject."""

from rtrun.execution.subjects import observation, suite, topology
from rtrun.execution.subjects.subject import SubjectModule
from rtrun.plan.observation import ObservationPlan
from rtrun.plan.run import Run
from rtrun.plan.topology.planning import TopologyPlan


def subject_of(run: Run) -> SubjectModule:
    """The module of the subject of a run."""
    match run.subject:
        case ObservationPlan():
            return observation
        case TopologyPlan():
            return topology
        case _:
            return suite
