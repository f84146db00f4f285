"""The processes and threads that live while programs are observed."""

from collections.abc import Iterable

from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import LivingProcess
from rtrun.flows.threads import ObservedThread
from rtrun.probes.hits import ObservedProgram


class ProcessTable:
    """The processes and threads that hits come from."""

    def __init__(self, state: ObservationState) -> None:
        self._state = state
        self.processes: dict[int, LivingProcess] = {}
        self.threads: dict[int, ObservedThread] = {}
        self._ran_before: frozenset[tuple[str, ...]] | None = None
        """The command lines of the programs that ran when the observation began; None before that is known."""
        self.feed = 0
        """The number of the next feed."""
        self._pids: dict[int, int] = {}
        """The pids of the listed threads, by thread."""

    def observe(self, programs: Iterable[ObservedProgram]) -> None:
        """Take all programs that run now: others have ended, and a pid may belong to a new program."""
        listed = {program.pid: program for program in programs}
        for pid, process in list(self.processes.items()):
            program = listed.get(pid)
            if program is None:
                # It may have ended after the hits of this feed: its last hits come with the next feed.
                if process.is_alive:
                    process.is_alive, process.ended_feed = False, self.feed
                elif self.feed - process.ended_feed > 1:
                    self._drop(process)
            elif process.program is None or _is_other(process.program, program):
                self._drop(process)
        if self._ran_before is None:
            self._ran_before = frozenset(program.argv for program in listed.values())
        for pid, program in listed.items():
            if pid not in self.processes:
                if not self._state.add_thing():
                    continue
                has_own_name = program.argv in self._ran_before
                self.processes[pid] = LivingProcess(pid, program, has_own_name=has_own_name)
            process = self.processes[pid]
            process.is_alive, process.program = True, program
        self._pids = {thread.tid: program.pid for program in listed.values() for thread in program.threads}
        for thread in list(self.threads.values()):
            program = listed.get(thread.process.pid)
            if program and program.threads and all(thread.tid != known.tid for known in program.threads):
                thread.has_ended = True
                del self.threads[thread.tid]
                self._state.drop_things(1)

    def thread(self, pid: int, tid: int) -> ObservedThread | None:
        """The thread of a hit; None if there is no room for it.

        Pid 0: the process is not known; the list of programs, or other hits of the thread, may show it.
        """
        pid = pid or self._pids.get(tid, 0)
        thread = self.threads.get(tid)
        if thread is None or (pid and thread.process.pid != pid):
            pid = pid or -tid
            process = self.processes.get(pid)
            if process is None:
                if not self._state.add_thing():
                    return None
                process = self.processes[pid] = LivingProcess(pid, None)
            if thread is None and not self._state.add_thing():
                return None
            thread = self.threads[tid] = ObservedThread(tid, process)
        return thread

    def _drop(self, process: LivingProcess) -> None:
        process.is_alive = False
        del self.processes[process.pid]
        before = len(self.threads)
        self.threads = {tid: thread for tid, thread in self.threads.items() if thread.process is not process}
        self._state.drop_things(process.things + before - len(self.threads))

    def cut(self) -> None:
        """Hits are missing."""
        for thread in self.threads.values():
            thread.cut()


def _is_other(earlier: ObservedProgram, now: ObservedProgram) -> bool:
    return (earlier.start_ticks, earlier.argv) != (now.start_ticks, now.argv)
