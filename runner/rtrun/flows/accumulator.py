"""Turns the hits of probes into messages, timers, callbacks and paths while the hits come in."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter

from rtrun.flows.calls import CallRecord
from rtrun.flows.loops import LoopRecord
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.paths import PathRecord
from rtrun.flows.process_table import ProcessTable
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.rows import RowStore
from rtrun.flows.services import ServiceRecord
from rtrun.flows.threads import CallbackLog, ObservedThread
from rtrun.flows.timers import ClockOffsets
from rtrun.flows.topics import TopicRecord
from rtrun.flows.turns import Turn, TurnRecord
from rtrun.probes.hits import GAPS_MAX, SYSTEM, Gap, GapCause, Hit, ObservedProgram, joined
from rtrun.probes.loops import LoopWatch

HORIZON_NS = 10 * 10**9
# Both clocks are slewed alike, so any other change of their offset is a step.
_SET_LEAST_NS = 1000


class FlowAccumulator:
    """Reads messages, timers, callbacks and paths from hits, about once a second for hours.

    `observe` takes the running programs, before their hits are fed; `offset` takes the offsets of other clocks; `feed`
    takes the hits. Hits of a feed are later than those of earlier feeds, and a gap is fed no later than the hits after
    it. `begin_ns` is when the probes were placed.

    A publication that nobody took within `horizon_ns` is forgotten; a later reception of it is unmatched. `paths` are
    topics in the order of their messages. Finished rows go to the `store`, 48 bytes a message, 16 a call. `on_turn` is
    called with each turn of a thread, once its end is known, or once it is certain that the end was not seen. `loops`
    has its own `feed`, of the kernel's events; it reads those that its parameter names.
    """

    def __init__(
        self,
        *,
        begin_ns: int,
        paths: Sequence[Sequence[str]] = (),
        horizon_ns: int = HORIZON_NS,
        recorder: FlowRecorder | None = None,
        on_turn: Callable[[Turn], None] | None = None,
        store: RowStore | None = None,
        loops: LoopWatch | None = None,
    ) -> None:
        self.begin_ns = begin_ns
        self.newest_ns = self.until_ns = begin_ns
        self.gaps: list[Gap] = []
        self._join_from = 2 * GAPS_MAX
        self.in_gaps = 0
        """Hits within gaps, which are left out."""
        self.state = ObservationState(begin_ns, store or RowStore())
        self.offsets = ClockOffsets()
        self.paths = PathRecord(paths, self.state.store)
        self.topics = TopicRecord(self.state, self.paths, horizon_ns, recorder)
        self.calls = CallRecord(self.state, recorder)
        self.services = ServiceRecord(self.state)
        self.loops = LoopRecord(self.state, loops)
        self.turns = TurnRecord(on_turn, self.state) if on_turn is not None else None
        self._programs = ProcessTable(self.state)
        self._handlers: dict[str, Callable[[Hit, ObservedThread], None]] = {
            **self.topics.handlers,
            **self.calls.handlers,
            **self.services.handlers,
            "wait": lambda _hit, thread: thread.waits(),
            "guard_trigger": lambda _hit, thread: thread.triggers_guard(),
        }

    def observe(self, programs: Iterable[ObservedProgram]) -> None:
        """Take all programs that run now: others have ended, and a pid may belong to a new program."""
        running = tuple(programs)
        self._programs.observe(running)
        # Among programs with the same name, the one that began first gets the first number, even if another has the
        # first hit.
        begun = [
            (process.program.start_ticks, pid, process)
            for pid, process in self._programs.processes.items()
            if process.program and process.has_own_name
        ]
        for *_, process in sorted(begun, key=itemgetter(0, 1)):
            self.state.label(process, process.label)
        self.loops.observe(running)

    def offset(self, clock: str, at_ns: int, offset_ns: int) -> None:
        """Another clock was `offset_ns` ahead of the hits' clock when the hits' clock showed `at_ns`."""
        before_ns = self.state.offsets_ns.get(clock, offset_ns)
        if clock == SYSTEM and abs(offset_ns - before_ns) > _SET_LEAST_NS:
            self.topics.clock_was_set()
        self.state.offsets_ns[clock] = offset_ns
        self.offsets.add(clock, at_ns, offset_ns)

    def feed(self, items: Iterable[Hit | Gap]) -> None:
        """Read hits, and gaps between them, in any order within this feed. A hit that comes too late makes a gap.

        Raises NoRoom if more was measured than may be kept.
        """
        handlers, thread_of, state, turns = self._handlers, self._programs.thread, self.state, self.turns
        topics = self.topics
        is_late = False
        for item in sorted(items, key=itemgetter(0)):
            if isinstance(item, Gap):
                self._cut(item)
                continue
            at_ns = item.at_ns
            if at_ns < self.newest_ns and not is_late:
                # Further late hits are within the gap that the first one makes.
                is_late = True
                self._cut(Gap(at_ns, self.newest_ns, "hits came out of order", GapCause.EVENTS_LOST))
            if at_ns < state.blind_until_ns:
                self.in_gaps += 1
                continue
            self.newest_ns = at_ns
            thread = thread_of(item.pid, item.tid)
            if thread is None:
                continue
            if thread.published is not None:
                thread.published.until_ns, thread.published = at_ns, None
            if (handler := handlers.get(item.event)) is not None:
                handler(item, thread)
            else:
                thread.does_other_work()
            if turns is not None:
                turns.see(item, thread)
            if topics.has_too_many_takers:
                topics.expire(at_ns)
                state.store.ease()
        topics.expire(self.newest_ns)
        self.services.expire()
        state.store.ease()
        self._programs.feed += 1

    def finish(self, until_ns: int = 0) -> None:
        """End the feeds: there were no more hits until `until_ns`. Decide everything that waited for later hits."""
        self.until_ns = max(self.newest_ns, until_ns)
        self.topics.cut()
        self.loops.finish()

    def open_calls(self) -> Iterator[tuple[CallbackLog, int]]:
        """The callbacks of living threads that have begun and not ended, and when they began."""
        for thread in self._programs.threads.values():
            if thread.is_alive and thread.callbacks:
                opened = thread.callbacks[-1]
                if (log := opened.callback.logs.get(thread)) is not None:
                    yield log, opened.begin_ns

    def _cut(self, gap: Gap) -> None:
        self.gaps.append(gap)
        if len(self.gaps) > self._join_from:
            # Gaps are joined again only when there are twice as many.
            self.gaps = joined(self.gaps)
            self._join_from = 2 * max(GAPS_MAX, len(self.gaps))
        self.state.cut(gap.until_ns)
        self.topics.cut()
        self._programs.cut()
