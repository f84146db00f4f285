"""An observation: probes are placed on the programs of a target, and their hits are streamed until it is over."""

import contextlib
import queue
import threading
import time
from collections.abc import Collection, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from rtrun.probes.hits import Gap, GapCause
from rtrun.probes.loops import BUFFER_KB, LoopWatch
from rtrun.probes.placement import PlacedProbe, Placement, RefusedProbe
from rtrun.probes.programs import ObservableProgram, pattern
from rtrun.probes.stream import Batch, Ready, WatchReader
from rtrun.targets.errors import ConnectionLost, TargetError
from rtrun.targets.link import TargetRebooted
from rtrun.targets.shell import POLL_S

if TYPE_CHECKING:
    from rtrun.targets.connection import Connection
    from rtrun.targets.link import Link

LIMIT_PER_S = 40_000
# To place fifty probes on a slow board, and to take them off again.
SET_UP_S = 120.0
# How long to wait for the end once the caller has closed the iterator.
END_S = 30.0
# An event with its topic takes less. The buffer holds two seconds at the limit.
_EVENT_BYTES = 100
_BUFFER_KB = (2048, 65536)
# The kernel writes more of its own events, with every switch of threads.
_BUFFER_KERNEL_KB = 4096
# A line goes to the target every BEAT_S. After SILENCE_S without a line the target takes the probes off: the link is
# dead, or this process was stopped. A wireless connection may pause for some seconds.
BEAT_S = 10.0
SILENCE_S = 30
SILENT = 4  # the exit status then
# The script prints a round about once a second, or after a rest of 10 s at most. If nothing comes for QUIET_S, the
# printing process was stopped or killed. To take the probes off, the script waits for its last events and their reader.
QUIET_S = 40.0  #: silence after which the reader of an observation's probes counts as stopped
TAKE_OFF_S = 2.0 * SILENCE_S  #: taking the probes off
LATE_S = 300.0  #: reading the rest after the end of an observation
_PIECES_MAX = 8  #: unread pieces of an observation, of up to 2 MiB; the target waits then


@dataclass(frozen=True, kw_only=True, slots=True)
class Began:
    """The probes are placed, and hits are recorded from now on."""

    placed: tuple[PlacedProbe, ...]
    refused: tuple[RefusedProbe, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Finished:
    """The observation is over; with `is_clean` everything was taken off the target.

    `lost_events` counts those that the kernel reports as lost; the gaps of the batches show when. `broken` is the
    reason if the observation ended early, and what was yielded before is then all; otherwise it is empty.
    """

    lost_events: int
    rests: int
    is_clean: bool
    broken: str = ""
    unfollowed: int = 0
    """How many threads had a loop that was not observed, at most at one time, because there were too many."""


Observed = Began | Batch | Finished


def observe(
    link: "Link",
    scripts: PurePosixPath,
    placement: Placement,
    programs: Sequence[ObservableProgram],
    *,
    for_s: float,
    kernel_events: Collection[str] = (),
    loops: LoopWatch | None = None,
    limit_per_s: int = LIMIT_PER_S,
) -> Generator[Observed, None, None]:
    """Place probes on a target, and yield what they see: `Began`, a `Batch` about once a second, `Finished`.

    `programs` are those whose threads are known with their processes; other programs that use the same libraries are
    found meanwhile. `kernel_events` are as in trace_events.yml. With `loops` their events come, too: of their threads
    alone, unless there are other kernel events. After `for_s` seconds, or when the caller closes the iterator,
    everything is taken off. The watchdog on the target does that, too, if the connection breaks or this
    process is killed. A lost connection is made again, and the script is called again if it prints nothing any more; a
    gap covers the time in which nothing was seen. Once something was seen, `Finished` reports what ended it.

    Nobody else may use the link meanwhile. Raises TargetError if the user lacks the right, the kernel has no probes, or
    the target does not answer; TargetRebooted at any time.
    """
    watching = _Watching(link, scripts, placement, programs, for_s, tuple(kernel_events), loops, limit_per_s)
    thread = threading.Thread(target=watching.run, name="observe", daemon=True)
    thread.start()
    try:
        yield from watching.results()
    finally:
        watching.is_over.set()
        watching.let_end(thread)


_LOST = {
    GapCause.LINK_LOST: "the connection to the target was lost",
    GapCause.WATCHDOG_SILENT: "nothing came from watch_probes.sh: it was stopped or killed on the target",
}


class _Watching:
    """Calls watch_probes.sh in a thread of its own; the caller's thread reads what it prints."""

    def __init__(
        self,
        link: "Link",
        scripts: PurePosixPath,
        placement: Placement,
        programs: Sequence[ObservableProgram],
        for_s: float,
        kernel_events: tuple[str, ...],
        loops: LoopWatch | None,
        limit_per_s: int,
    ) -> None:
        self._link, self._placement = link, placement
        self._probes = {probe.name: probe for probe in placement.probes}
        self._pids = {thread.tid: program.program.pid for program in programs for thread in program.program.threads}
        buffer_kb = min(max(limit_per_s * 2 * _EVENT_BYTES // 1024, _BUFFER_KB[0]), _BUFFER_KB[1])
        buffer_kb += _BUFFER_KERNEL_KB if kernel_events else 0
        buffer_kb += BUFFER_KB if loops is not None else 0
        self._is_traced = bool(kernel_events) or loops is not None
        self._loops = loops.names if loops is not None else ()
        self._for_s = for_s
        self._next_beat_s = 0.0
        # Set again once the probes are placed: `for_s` counts from then on.
        self._end_s = time.monotonic() + for_s + SET_UP_S
        self._arguments = (str(buffer_kb), str(limit_per_s), pattern(), *kernel_events)
        self._script = str(scripts / "watch_probes.sh")
        watched = " ".join(str(program.program.pid) for program in programs)
        lines = [*(probe.line for probe in placement.probes), *([f"watch {watched}"] if watched else [])]
        lines += ["raw"] if any(probe.needs_raw for probe in placement.probes) else []
        lines += [*(loops.lines if loops is not None else ()), "go", ""]
        self._stdin = "\n".join(lines).encode()
        self.is_over = threading.Event()
        self._connection: Connection | None = None
        # How long nothing has come, and how long the time has been over, without times in which this process was
        # stopped.
        self._asked_s = 0.0
        self._quiet_s = self._over_s = 0.0
        self._is_ready = False
        self._lost = GapCause.LINK_LOST
        self._pieces: queue.Queue[bytes | WatchReader | BaseException | None] = queue.Queue(_PIECES_MAX)

    def run(self) -> None:
        """Call the script until it is over; pass on a reader and the output of each call, then None or an error."""
        try:
            self._link.do(self._call)
            self._put(None)
        except BaseException as error:
            self._put(error)

    def _call(self, connection: "Connection") -> None:
        if self._is_time_over():
            return
        reader = WatchReader(
            self._probes, str(connection.address), self._pids, is_traced=self._is_traced, loops=self._loops
        )
        self._put(reader)
        self._connection = connection
        self._asked_s, self._quiet_s, self._over_s, self._is_ready = time.monotonic(), 0.0, 0.0, False
        left_s = max(0.0, self._end_s - time.monotonic())
        argv = [self._script, str(round(left_s + SET_UP_S)), str(SILENCE_S), *self._arguments]
        status, stderr = connection.shell.execute(
            argv, [self._stdin], self._take, left_s + 2 * SET_UP_S, feed=self._feed
        )
        if status == SILENT:
            # As after a broken connection: the probes are placed again, with a gap between.
            raise ConnectionLost(f"{connection.address}: {stderr.strip().rpartition(chr(10))[2][:300]}")
        if status > 128:
            raise TargetError(f"{connection.address}: watch_probes.sh was ended there by signal {status - 128}")
        if status != 0:
            text = stderr.strip().rpartition("\n")[2][:300] or f"watch_probes.sh ended with exit status {status}"
            raise TargetError(f"{connection.address}: {text}")
        if not self._is_time_over():
            raise TargetError(f"{connection.address}: watch_probes.sh ended there before its time")

    def _feed(self) -> bytes | None:
        """The input of the script: a line now and then shows that this process is alive; None at the end.

        Raises ConnectionLost if the script prints nothing any more, or does not end.
        """
        self._check_quiet()
        if self._is_time_over():
            return None
        if time.monotonic() < self._next_beat_s:
            return b""
        self._next_beat_s = time.monotonic() + BEAT_S
        return b"\n"

    def _check_quiet(self) -> None:
        now_s = time.monotonic()
        passed_s, self._asked_s = min(now_s - self._asked_s, 2 * POLL_S), now_s
        self._quiet_s += passed_s
        self._over_s += passed_s if self._is_time_over() else 0.0
        if self._quiet_s > (QUIET_S if self._is_ready else SET_UP_S) or self._over_s > TAKE_OFF_S:
            self._lost = GapCause.WATCHDOG_SILENT
            what = "is not ended" if self._over_s > TAKE_OFF_S else "prints nothing any more"
            raise ConnectionLost(f"{self._script} {what} on the target: was it stopped or killed there?")

    def _take(self, piece: bytes) -> None:
        self._put(piece)
        self._quiet_s = 0.0

    def _is_time_over(self) -> bool:
        return self.is_over.is_set() or time.monotonic() >= self._end_s

    def _put(self, piece: "bytes | WatchReader | BaseException | None") -> None:
        if piece == b"":
            return
        while True:
            # Once it is over, pieces are no longer taken, and the target must not wait for each of them.
            is_over = self.is_over.is_set()
            with contextlib.suppress(queue.Full):
                self._pieces.put(piece, timeout=0.0 if is_over else POLL_S)
                return
            if is_over:
                with contextlib.suppress(queue.Empty):
                    self._pieces.get_nowait()

    def let_end(self, thread: threading.Thread) -> None:
        """Wait for the end of the call; break its connection when the target does not let it end."""
        thread.join(END_S)
        if thread.is_alive() and self._connection is not None:
            self._connection.interrupt()
            thread.join(END_S)

    def results(self) -> Iterator[Observed]:
        """Read what the script prints. Raises what ends it before anything was seen, and TargetRebooted at any time."""
        reader: WatchReader | None = None
        calls = lost = rests = unfollowed = 0
        seen_ns = 0
        broken = ""
        while True:
            piece = self._pieces.get()
            if isinstance(piece, BaseException):
                if not seen_ns or not isinstance(piece, TargetError) or isinstance(piece, TargetRebooted):
                    raise piece
                broken, piece = str(piece), None
            try:
                if isinstance(piece, bytes) and time.monotonic() > self._end_s + LATE_S:
                    raise TargetError(f"what came could not be read within {LATE_S:g} s after the end")
                for report in self._read(reader, piece):
                    if isinstance(report, Batch):
                        gap_ns, seen_ns = seen_ns, max(seen_ns, report.until_ns)
                        if reader is not None and 0 < gap_ns < reader.begin_ns:
                            gap = Gap(gap_ns, reader.begin_ns, _LOST[self._lost], self._lost)
                            report = replace(report, gaps=(gap, *report.gaps))
                            self._lost = GapCause.LINK_LOST
                        rests += sum(gap.cause is GapCause.RESTED for gap in report.gaps)
                        yield report
                    elif calls == 1:
                        self._end_s = time.monotonic() + self._for_s
                        yield self._began(report)
            except TargetError as error:
                # The target printed something that cannot be read: nothing more is taken from it.
                if not seen_ns:
                    raise
                broken, piece = str(error), None
            if isinstance(piece, bytes):
                continue
            lost += reader.lost if reader is not None else 0
            unfollowed = max(unfollowed, reader.unfollowed if reader is not None else 0)
            if piece is None:
                if not broken and reader is not None and reader.is_done and not reader.is_read_to_end:
                    broken = "what prints the events on the target was ended there"
                yield Finished(
                    lost_events=lost,
                    rests=rests,
                    is_clean=reader is not None and reader.is_done,
                    broken=broken,
                    unfollowed=unfollowed,
                )
                return
            reader, calls = piece, calls + 1

    def _read(self, reader: WatchReader | None, piece: "bytes | WatchReader | None") -> Iterator[Ready | Batch]:
        if isinstance(piece, bytes) and reader is not None:
            for report in reader.feed(piece):
                self._is_ready |= isinstance(report, Ready)
                yield report
        elif reader is not None and reader.begin_ns:
            # The call has ended.
            yield reader.rest()

    def _began(self, ready: Ready) -> Began:
        refused = (
            RefusedProbe(path=self._probes[name].path, event=self._probes[name].event, reason=reason)
            for name, reason in ready.refused.items()
        )
        return Began(
            placed=tuple(self._probes[name] for name in ready.placed), refused=(*self._placement.refused, *refused)
        )
