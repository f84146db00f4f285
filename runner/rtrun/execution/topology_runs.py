"""A topology on a target: one program for each of its processes, what they wrote, and the runs of its streams."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from rtfiles.errors import UsageError
from rtrun.execution.download import JSON_LIMIT_BYTES, NPY_HEADER_BYTES
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import SubjectPrograms
from rtrun.execution.stream_runs import StreamFacts, write_streams
from rtrun.flows.topology.chains import Spans, Stage, ages, origins, reactions, stages
from rtrun.flows.topology.fates import fates
from rtrun.flows.topology.streams import topology_streams
from rtrun.flows.topology.tables import (
    ACTIVATION,
    RECEPTION,
    NodeTable,
    TopologyTables,
    host_name,
    read_tables,
    table_names,
)
from rtrun.kinds.values import Int64s
from rtrun.plan import suites
from rtrun.plan.program import Program
from rtrun.plan.run import Run
from rtrun.plan.suites import Value, middleware_of
from rtrun.plan.topology.node_text import process_text
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.rates import most_activations
from rtrun.plan.topology.topology import NodePath, Topology
from rtrun.results.output import HostRecord, Thread
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus
from rtrun.results.topology_record import (
    CycleStep,
    HopFigures,
    NodeFigures,
    PathFigures,
    Spread,
    TopologyRecord,
    write_topology,
)
from rtrun.targets.inspection.facts import TargetState

PROGRAM = "topology_node"
_THREAD_NAME_MAX = 15  # characters: the kernel cuts names of threads there
_POLICIES = {"0": "OTHER"}


def topology_programs(
    prepared: Prepared,
    run: Run,
    plan: TopologyPlan,
    remote: PurePosixPath,
    environment: tuple[tuple[str, str], ...],
    deadline_s: float,
) -> SubjectPrograms:
    """A program for each process of the topology of a run, in its folder `remote` on the target."""
    path = prepared.programs[suites.executable(run.suite, PROGRAM, run.parameters)]
    texts = {f"{host_name(name)}.topology": process_text(plan, name) for name in plan.topology.processes}
    programs = tuple(
        Program(
            name=host_name(name),
            argv=(path, str(remote / f"{host_name(name)}.topology"), "--out-dir", str(remote)),
            environment=environment,
            deadline_s=deadline_s,
        )
        for name in plan.topology.processes
    )
    return SubjectPrograms(
        deadline_s=deadline_s,
        stages=(programs,),
        texts=texts,
        file_limits=_file_limits(plan),
        need_one_another=True,
    )


def _file_limits(plan: TopologyPlan) -> dict[str, int]:
    topology = plan.topology
    rows = most_activations(topology, plan.measure_ns)
    limits = {f"{host_name(name)}.json": JSON_LIMIT_BYTES for name in topology.processes}
    for node in topology.nodes:
        own, *of_inputs = table_names(node)
        limits[f"{own}.npy"] = 8 * rows[node.name] * (len(ACTIVATION) + len(node.inputs)) + NPY_HEADER_BYTES
        for name, topic in zip(of_inputs, node.inputs, strict=True):
            limits[f"{name}.npy"] = 8 * rows[topology.publisher[topic].name] * len(RECEPTION) + NPY_HEADER_BYTES
    return limits


def read_run(folder: Path, run: Run, topology: Topology) -> TopologyTables | str:
    """Read what the processes of a topology have written, or say why it does not count."""
    try:
        tables = read_tables(folder, topology)
    except UsageError as error:
        return str(error).replace(f"{folder}/", "")
    for name, host in tables.hosts.items():
        if host.middleware != run.middleware:
            return f"{name}: asked for the middleware {run.middleware}, it measured through {host.middleware}"
        if wrong := _wrong_thread(topology, name, host) or _wrong_fact(name, host, run):
            return wrong
        if foreign := sum(executor.foreign for executor in host.executors):
            return f"{name}: {foreign} messages came that no node of the topology has sent: somebody uses its topics"
    return tables


def _wrong_fact(process: str, host: HostRecord, run: Run) -> str | None:
    """Name a setting of the middleware that is in effect instead of the requested one, or None."""
    for key, fact in host.in_effect.facts.items():
        asked = run.parameters.get(key)
        if asked not in (None, "") and str(asked) != fact:
            return f"{process}: asked for {key} {asked}, in effect was {fact or 'none'}"
    return None


def _wrong_thread(topology: Topology, process: str, host: HostRecord) -> str | None:
    """Name an executor of a process that did not run as requested, or None."""
    for executor in topology.executors:
        if executor.process != process:
            continue
        name = executor.name[:_THREAD_NAME_MAX]
        policy = _POLICIES.get(executor.policy, executor.policy)
        asked = (policy, executor.priority)
        own = [thread for thread in host.in_effect.threads if thread.name == name]
        cpus = {*executor.cpus}
        if any((thread.policy, thread.priority) == asked and (not cpus or {*thread.cpus} == cpus) for thread in own):
            continue
        on = f" on CPUs {','.join(map(str, executor.cpus))}" if cpus else ""
        seen = "; ".join(
            f"{thread.policy} {thread.priority} on CPUs {','.join(map(str, thread.cpus))}" for thread in own
        )
        return (
            f"executor {executor.name}: asked for {policy} {executor.priority}{on}, in effect was {seen or 'nothing'}"
        )
    return None


def write(
    partial: Path, folder: Path, plan: TopologyPlan, record: RunRecord, state: TargetState, tables: TopologyTables
) -> RunRecord:
    """Write a run for each stream of a topology next to `folder`, and topology.json into `partial`.

    Returns the closing record of the run itself. Raises InfrastructureError if something cannot be written.
    """
    programs = [_program(program, tables) for program in record.programs]
    # All its streams were measured at the same time, so that time counts once, as in an observation.
    record = record.model_copy(update={"programs": programs, "subject": "attached"})
    written = write_streams(
        folder,
        StreamFacts(
            record=record.model_copy(update={"attempt": "", "observed_by": record.run}),
            state=state,
            start_time=record.start_time,
            end_time=record.end_time,
            deadlines=plan.deadlines,
            programs=functools.partial(_programs, plan.topology, programs),
            # A run that names no middleware was measured through the default one.
            parameters={**record.parameters, "middleware": middleware_of(record.suite, record.parameters)},
        ),
        list(topology_streams(tables, plan)),
        {},
    )
    if written.unseen and record.status is RunStatus.OK:
        record = record.model_copy(update={"status": RunStatus.FAILED, "reason": "; ".join(written.unseen)})
    write_topology(partial, figures(tables, plan))
    return record


def _program(program: ProgramRecord, tables: TopologyTables) -> ProgramRecord:
    host = next((host for name, host in tables.hosts.items() if host_name(name) == program.name), None)
    threads: list[Thread] = host.in_effect.threads if host else []
    return program.model_copy(update={"threads": threads, "costs": host.costs if host else None})


def _programs(
    topology: Topology, programs: Sequence[ProgramRecord], parameters: Mapping[str, Value], parties: Sequence[str]
) -> Sequence[ProgramRecord]:
    """The programs that host the nodes named by a stream's parameters."""
    nodes = {str(parameters.get(key) or "").removeprefix("/") for key in parties}
    nodes |= {topology.publisher[topic].name for topic in str(parameters.get("path") or "").split(",") if topic}
    hosts = {host_name(topology.executor[topology.node[name].executor].process) for name in nodes if name}
    return [program for program in programs if program.name in hosts]


def figures(tables: TopologyTables, plan: TopologyPlan) -> TopologyRecord:
    """The figures of each node, hop and path."""
    return TopologyRecord(
        schema=1,
        topology=tables.topology,
        nodes=[_node(tables.nodes[node.name]) for node in tables.topology.nodes],
        hops=[_hop(tables, number) for number in range(len(tables.hops))],
        paths=[_path(tables, path) for path in plan.paths],
    )


def _spread(values_ns: Int64s) -> Spread:
    if not values_ns.size:
        return Spread(median_ns=None, max_ns=None)
    return Spread(median_ns=int(np.median(values_ns)), max_ns=int(values_ns.max()))


def _node(table: NodeTable) -> NodeFigures:
    measured = slice(table.first, None)
    return NodeFigures(
        node=table.name,
        activations=table.release_ns.size - table.first,
        overruns=table.skipped,
        cpu=_spread(table.cpu_ns[measured]),
        response=_spread((table.end_ns - table.release_ns)[measured]),
        lateness=_spread((table.begin_ns - table.release_ns)[measured]),
    )


def _hop(tables: TopologyTables, number: int) -> HopFigures:
    hop = tables.hops[number]
    of_hop = fates(tables, hop)
    return HopFigures(
        topic=hop.topic,
        publisher=hop.publisher,
        subscriber=hop.subscriber,
        sent=of_hop.sent,
        taken=of_hop.taken,
        overwritten=of_hop.overwritten,
        unused=of_hop.unused,
        lost=of_hop.lost,
        latency=_spread((hop.reception_ns - hop.publication_ns)[of_hop.rows]),
    )


def _path(tables: TopologyTables, path: NodePath) -> PathFigures:
    sources = origins(tables, path)
    reaction, age = reactions(tables, path, sources[0]), ages(tables, path, sources[0])
    worst: list[CycleStep] = []
    longest = _longest(reaction)
    if longest is not None:
        cycle = stages(tables, path, sources, int(reaction.activation[longest]))
        worst = [_step(stage, int(reaction.begin_ns[longest])) for stage in cycle]
    return PathFigures(
        topics=[*path.topics],
        nodes=[*path.nodes],
        reaction=_spread(reaction.end_ns - reaction.begin_ns),
        age=_spread(age.end_ns - age.begin_ns),
        worst=worst,
    )


def _longest(spans: Spans) -> int | None:
    lengths = spans.end_ns - spans.begin_ns
    return int(lengths.argmax()) if lengths.size else None


def _step(stage: Stage, from_ns: int) -> CycleStep:
    node, row = stage.node, stage.row
    return CycleStep(
        node=node.name,
        release_ns=int(node.release_ns[row]) - from_ns,
        begin_ns=int(node.begin_ns[row]) - from_ns,
        done_ns=int(node.done_ns[row]) - from_ns,
        end_ns=int(node.end_ns[row]) - from_ns,
        publication_ns=None if stage.publication_ns is None else stage.publication_ns - from_ns,
        reception_ns=None if stage.reception_ns is None else stage.reception_ns - from_ns,
    )
