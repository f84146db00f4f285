"""What threatens the deadlines of running programs: the scheduling of their threads, and their memory."""

from collections.abc import Iterator, Sequence

from rtfiles.output import counted, listed, printable
from rtrun.flows.programs import label_of
from rtrun.probes.hits import ObservedProgram, ProgramThread

_NAMED_MAX = 4  # threads that a hazard names


def hazards(programs: Sequence[ObservedProgram], *, with_pids: bool = True) -> tuple[str, ...]:
    """A sentence for each thing that may delay some of these programs, with their names and, if asked, their pids."""
    threatened: dict[str, list[str]] = {}
    for program in programs:
        for text in _of(program, programs):
            pid = f" (pid {program.pid})" if with_pids else ""
            threatened.setdefault(text, []).append(label_of(program) + pid)
    return tuple(printable(f"{listed(names, _NAMED_MAX)}: {text}") for text, names in threatened.items())


def _of(program: ObservedProgram, programs: Sequence[ObservedProgram]) -> Iterator[str]:
    ordinary = [thread for thread in program.threads if not thread.is_real_time]
    if len(ordinary) == len(program.threads):
        yield "no thread is real-time: any other one may run before it"
    elif ordinary:
        yield f"{counted(len(ordinary), 'thread')} not real-time: {_names(ordinary)}"
    if not program.locked_bytes:
        yield "memory is not locked: a page fault may read from a disk"
    above = {
        f"{other.name} of {label_of(owner)} ({other.policy} {other.priority})": None
        for owner in programs
        if owner is not program
        for other in owner.threads
        if any(_may_delay(other, thread) for thread in program.threads)
    }
    if above:
        yield f"on the same CPUs with a higher priority: {listed(above, _NAMED_MAX)}"


def _may_delay(other: ProgramThread, thread: ProgramThread) -> bool:
    """Whether another thread may run before a real-time thread on a CPU that both may use."""
    if not thread.is_real_time or thread.policy == "DEADLINE" or not set(other.cpus) & set(thread.cpus):
        return False
    return other.policy == "DEADLINE" or (other.is_real_time and other.priority > thread.priority)


def _names(threads: Sequence[ProgramThread]) -> str:
    return listed(dict.fromkeys(thread.name for thread in threads), _NAMED_MAX)
