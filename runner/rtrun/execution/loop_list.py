"""The real-time threads of a target: how each is scheduled, and what wakes it, seen in the kernel's events."""

import contextlib
from collections.abc import Iterator
from pathlib import PurePosixPath

from rtfiles.output import printable
from rtrun.execution.observation import NO_ADDRESSES, Watched
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.plan.topology.rates import cpus_text
from rtrun.probes import session
from rtrun.probes.hits import ObservedProgram, ProgramThread
from rtrun.probes.loops import is_observed
from rtrun.probes.placement import Placement
from rtrun.probes.stream import Batch
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

# A loop of 10 Hz shows its period within this time.
LOOK_S = 2.0


def list_loops(link: Link, scripts: PurePosixPath, watched: Watched) -> tuple[str, ...]:
    """A sentence for each thread whose loop would be observed, and one if the kernel's events cannot be read."""
    names = watched.loops.names if watched.loops is not None else ()
    threads = [
        (found.program, thread)
        for found in watched.found
        for thread in found.program.threads
        if is_observed(found.program, thread, names)
    ]
    if not threads:
        return ()
    seen: FlowAccumulator | None = None
    missing: list[str] = []
    try:
        seen = _look(link, scripts, watched)
    except TargetError as error:
        missing = [f"not known what wakes real-time threads: {error}"]
    if seen is not None:
        missing += seen.loops.missing
    return (*(_in_words(program, thread, seen) for program, thread in threads), *missing)


def _look(link: Link, scripts: PurePosixPath, watched: Watched) -> FlowAccumulator | None:
    nothing = Placement(probes=(), refused=())
    if watched.loops is None:
        raise TargetError(NO_ADDRESSES)
    stream = session.observe(link, scripts, nothing, watched.found, for_s=LOOK_S, loops=watched.loops)
    seen: FlowAccumulator | None = None
    with contextlib.closing(stream):
        for batch in _batches(stream):
            if seen is None:
                seen = FlowAccumulator(begin_ns=batch.begin_ns, loops=watched.loops)
                seen.observe(found.program for found in watched.found)
            seen.loops.feed(batch.kernel, batch.gaps, batch.realtime_offset_ns)
    return seen


def _batches(stream: Iterator[session.Observed]) -> Iterator[Batch]:
    return (batch for batch in stream if isinstance(batch, Batch) and batch.begin_ns)


def _in_words(program: ObservedProgram, thread: ProgramThread, seen: FlowAccumulator | None) -> str:
    policy = f"{thread.policy} {thread.priority}" if thread.priority else thread.policy
    known = seen.loops.threads.get(thread.tid) if seen is not None else None
    name = known.log.thread if known is not None else thread.name
    rhythm = f": {known.log.rhythm()}" if known is not None else ""
    cpus = f", CPUs {cpus_text(thread.cpus)}" if thread.cpus else ""
    return printable(f"thread {program.file_name}/{name} (pid {program.pid}, {policy}{cpus}){rhythm}")
