"""The user's system: started by its command on the target, awaited until it is ready, ended with all that it
started."""

import contextlib
import time
from pathlib import PurePosixPath

from rtfiles.output import listed
from rtrun.execution import observation
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.topics import PUBLISHER
from rtrun.plan.observation import ObservationPlan
from rtrun.plan.program import Exit, Program
from rtrun.probes import session
from rtrun.probes.programs import ObservableProgram
from rtrun.probes.stream import Batch
from rtrun.targets import processes
from rtrun.targets.link import Link

SYSTEM = "system"
"""The name of the program that runs the command."""
# A launch file of a large robot takes a minute or two on a small board.
READY_S = 180.0  #: waiting for the system that a campaign starts to be ready
# How long to watch for a topic at a time: afterwards there may be more programs, with other libraries.
LOOK_S = 5.0
POLL_S = 0.5
# The programs themselves have 17 s to end.
END_S = 60.0  #: ending that system
_NAMES_SHOWN = 8
_RUN = 'cd "${HOME:-/}" || cd /; exec sh -c "$1"'


def program_of(command: str, deadline_s: float) -> Program:
    """The program of a run that runs a command by sh, in the home folder."""
    return Program(name=SYSTEM, argv=("sh", "-c", _RUN, "sh", command), deadline_s=deadline_s)


def wait_ready(
    link: Link, scripts: PurePosixPath, remote: PurePosixPath, plan: ObservationPlan, *, deadline_s: float = READY_S
) -> str | None:
    """Wait until the system can be observed and publishes its ready topic; return why it does not.

    A system that runs already is ready when one of its programs can be observed.
    """
    end_s = time.monotonic() + deadline_s
    topic = plan.system.ready_topic
    published: set[str] = set()
    while True:
        if plan.system.start and (ended := end_of(link, remote)):
            return f"the command ended before the system was ready, {ended}"
        watched = observation.watch(link, scripts, plan)
        own = watched.found
        if plan.system.start:
            pids = processes.look(link, remote, SYSTEM).pids
            own = tuple(found for found in watched.found if found.program.pid in pids)
        if not topic and (own or (plan.loops and not plan.system.start)):
            # A program with a named loop may begin later.
            return None
        if own:
            published |= _published(link, scripts, watched, own, topic)
        if topic in published:
            return None
        if time.monotonic() >= end_s:
            return _never_ready(own, topic, published, deadline_s, is_started=bool(plan.system.start))
        time.sleep(POLL_S)


def _never_ready(
    own: tuple[ObservableProgram, ...], topic: str, published: set[str], waited_s: float, *, is_started: bool
) -> str:
    if not own and is_started:
        return (
            f"waited {waited_s:g} s for a program of the system that can be observed: the command has started none "
            "that uses ROS 2 or roscpp, or has a thread with a real-time policy"
        )
    if not own:
        return observation.NOTHING
    names = sorted(published)
    seen = f"seen were {listed(names, _NAMES_SHOWN)}" if names else "nothing was seen to be published"
    return f"waited {waited_s:g} s for the system to publish {topic}: {seen}"


def _published(
    link: Link, scripts: PurePosixPath, watched: observation.Watched, own: tuple[ObservableProgram, ...], topic: str
) -> set[str]:
    """The topics on which these programs publish, watched until `topic` is among them; none if there are no probes.

    Programs that began meanwhile do not count: it is not known yet whose they are.
    """
    published: set[str] = set()
    if not watched.placement.probes:
        return published
    pids = {found.program.pid for found in own}
    flows: FlowAccumulator | None = None
    with contextlib.closing(session.observe(link, scripts, watched.placement, watched.found, for_s=LOOK_S)) as stream:
        for batch in stream:
            if not isinstance(batch, Batch) or not batch.begin_ns:
                continue
            if flows is None:
                flows = FlowAccumulator(begin_ns=batch.begin_ns)
                flows.observe(found.program for found in watched.found)
            flows.feed([*batch.hits, *batch.gaps])
            known = flows.state.pids
            published = {
                name
                for role, name, label in flows.topics.ends
                if role == PUBLISHER and not pids.isdisjoint(known.get(label, ()))
            }
            if topic in published:
                break
    return published


def end_of(link: Link, remote: PurePosixPath) -> str | None:
    """How the system ended, with its last line of output; None while it runs.

    A command that succeeded may leave the system running. If it failed or lost its supervisor, the system has ended.
    """
    standing = processes.look(link, remote, SYSTEM)
    if standing.status is None and not standing.is_alone:
        return None
    if standing.status == 0 and standing.pids:
        return None
    last_line = processes.read_last_line(link, remote / f"{SYSTEM}.stderr") or "it said nothing"
    if standing.status is None:
        return f"killed from outside: {last_line}"
    return f"with exit status {standing.status}: {last_line}"


def end(link: Link, remote: PurePosixPath) -> Exit:
    """End everything that the command started and that still runs. Return its exit status if it ended on its own."""
    standing = processes.look(link, remote, SYSTEM)
    processes.end(link, remote, SYSTEM, stages=processes.LIKE_CTRL_C)
    return Exit(status=standing.status, expired=False)
