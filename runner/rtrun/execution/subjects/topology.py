"""A graph of nodes of our own, which write down when they were due, began and ended."""

from pathlib import PurePosixPath

from rtrun.execution import topology_runs
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import SubjectPrograms, environment_of
from rtrun.execution.subjects.subject import Closing
from rtrun.execution.subjects.suite import deadline_of, start, wait
from rtrun.plan import suites
from rtrun.plan.run import Run
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.results.record import RunRecord, RunStatus

__all__ = ["close", "plan", "start", "wait"]


def _plan_of(run: Run) -> TopologyPlan:
    assert isinstance(run.subject, TopologyPlan)
    return run.subject


def plan(prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> SubjectPrograms:
    """A program for each process of the graph, with the text that tells it what to host."""
    environment = (*environment_of(prepared, run.middleware), *suites.environment(run.parameters))
    return topology_runs.topology_programs(prepared, run, _plan_of(run), remote, environment, deadline_of(run))


def close(closing: Closing, record: RunRecord) -> RunRecord:
    """Write a run for each stream next to it; if its tables do not count, the run is invalid."""
    if record.status is not RunStatus.OK:
        return record
    of_nodes = _plan_of(closing.work.run)
    tables = topology_runs.read_run(closing.partial, closing.work.run, of_nodes.topology)
    if isinstance(tables, str):
        return record.model_copy(update={"status": RunStatus.INVALID, "reason": tables, "unrelated_end": None})
    return topology_runs.write(closing.partial, closing.place, of_nodes, record, closing.before, tables)
