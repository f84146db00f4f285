"""Observe programs that run already: place probes on them, and read their hits until the end."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path, PurePosixPath

from rtfiles.interruption import deferred
from rtfiles.output import counted
from rtrun.causes.outliers import AFTER_NS
from rtrun.execution.late_values import LateValueRecord
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures, Snapshot, gaps_in_words
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.rows import RowStore
from rtrun.plan.observation import ObservationPlan
from rtrun.probes import session
from rtrun.probes.hits import ObservedProgram
from rtrun.probes.libraries.description import events
from rtrun.probes.loops import FUNCTIONS, LoopWatch
from rtrun.probes.loops import THREADS_MAX as LOOPS_MAX
from rtrun.probes.placement import Placement, costly, place, refusals
from rtrun.probes.programs import ObservableProgram, Roster, find_programs, left_out_in_words
from rtrun.probes.session import Began, Finished
from rtrun.results.columns import NoRoom
from rtrun.results.coverage import Coverage, coverage
from rtrun.results.figures_so_far import FiguresSoFar
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import kernel_trace
from rtrun.targets.link import Link, TargetRebooted

# Events that are not read here, and the number of the others per second on a busy machine.
_FOR_PEOPLE = ("osnoise",)
_KERNEL_EVENTS_PER_S = 80_000  # by which a time is computed
# A program that restarts is back within this time.
GONE_NS = 10 * 10**9
NOTHING = "no program runs there that uses ROS, and no thread with a real-time policy"
NO_ADDRESSES = "no loop is measured: the kernel hides the addresses of its functions (kernel.kptr_restrict)"
KEPT_FIRST = "what was observed is kept first; Ctrl-C once more ends rtrun at once"
# Recorded only for paths of topics and causes of late values, because each message has several of them.
OF_PATHS = ("wait", "guard_trigger")


@dataclass(frozen=True, kw_only=True, slots=True)
class Watched:
    """The programs to observe on a target, the probes for them, and the loops to observe; None: there are none."""

    found: tuple[ObservableProgram, ...]
    placement: Placement
    loops: LoopWatch | None = None
    left_out: int = 0
    """How many programs are not observed because there are too many at one time."""

    @property
    def ros_programs(self) -> tuple[ObservableProgram, ...]:
        """Those that map a library with probes."""
        return tuple(program for program in self.found if program.mapped)

    def why_nothing(self, plan: ObservationPlan) -> str:
        """Why there is nothing to observe; empty if there is something, or a program with a named loop may begin."""
        if self.loops is None and plan.loops and not self.placement.probes:
            return NO_ADDRESSES
        if self.placement.probes or (
            self.loops is not None and (plan.loops or len(self.ros_programs) < len(self.found))
        ):
            return ""
        return "; ".join(refusals(self.placement.refused)) or NOTHING


def _ignore(_seen: object) -> None:
    pass


@dataclass(frozen=True, kw_only=True, slots=True)
class Onlooker:
    """The follower of a run, and how it is notified.

    `on_figures` is called every few seconds with what a suite has measured so far; None: the target is not asked.
    `on_second` is called about once a second with the state of an observation, `on_end` with the whole result.
    `is_attended`: a user waits for the observation. Then Ctrl-C ends it like the end of its time, and what was seen is
    kept; if nothing can be observed, that is reported at once.
    """

    on_figures: Callable[[FiguresSoFar], None] | None = None
    on_second: Callable[[Snapshot], None] = _ignore
    on_end: "Callable[[ObservationResult], None]" = _ignore
    recorder: FlowRecorder | None = None
    is_attended: bool = False


NOBODY = Onlooker()


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservationResult:
    """What was observed: the flows, all programs that ran meanwhile, the placed probes, and how it ended."""

    flows: FlowAccumulator
    programs: tuple[ObservedProgram, ...]
    began: Began
    finished: Finished | None
    start_time: str
    end_time: str
    coverage: Coverage
    broken: str = ""
    """Why it ended early against the user's will; empty: it did not."""
    programs_left_out: int = 0
    cut_off: BaseException | None = None
    """An error that ends more than this run, raised once the run is kept: a restart or Ctrl-C while nobody attends, a
    second Ctrl-C, a defect of ours."""
    late: LateValueRecord | None = None
    """Late values, some with the kernel's trace; None: they were not asked for."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is missing in the observation, one sentence each."""
        lines = [*refusals(self.began.refused), *costly(self.began.placed)]
        lines += self.flows.loops.missing
        if self.finished and self.finished.unfollowed:
            more = counted(self.finished.unfollowed, "more thread")
            lines.append(f"{more} with a loop to observe than {LOOPS_MAX}: they are not observed")
        if self.programs_left_out:
            lines.append(left_out_in_words(self.programs_left_out))
        if self.coverage.in_words:
            lines.append(self.coverage.in_words)
        if self.broken:
            lines.append(f"it was ended early: {self.broken}")
        if self.flows.gaps:
            lines.append(f"{gaps_in_words(self.flows.gaps)}: what was then counts as neither seen nor lost")
        if self.finished and self.finished.lost_events:
            lines.append(f"{counted(self.finished.lost_events, 'event')} lost by the kernel: what was then is left out")
        if self.finished and self.finished.rests:
            lines.append(f"{counted(self.finished.rests, 'rest')} of the probes: more events than the limit")
        if self.finished is None or not self.finished.is_clean:
            lines.append("the probes were not seen to be taken off: the next call takes off what is left")
        return tuple(dict.fromkeys(lines))


def watch(link: Link, scripts: PurePosixPath, plan: ObservationPlan, *, trace: str = "") -> Watched:
    """Inspect a target without changing it, and resolve the probes for its programs. Raises TargetError."""
    wanted = [event for event in events() if plan.followed or trace or event not in OF_PATHS]
    listing = find_programs(link, scripts, plan.loops)
    found = listing.found
    if not found and link.check(["id", "-u"]).strip() != "0":
        raise TargetError(f"{link.target.address}: observing takes root: the programs of other users cannot be seen")
    functions = kernel_trace.read_symbols(link, FUNCTIONS)
    return Watched(
        found=found,
        placement=place(link, found, events=wanted),
        loops=LoopWatch(names=plan.loops, functions=functions) if functions else None,
        left_out=listing.left_out,
    )


def observe(
    link: Link,
    scripts: PurePosixPath,
    watched: Watched,
    plan: ObservationPlan,
    *,
    trace: str,
    onlooker: Onlooker,
    now: Callable[[], datetime],
    folder: Path | None = None,
) -> ObservationResult:
    """Observe for the time of the plan; `trace` is the limit above which kernel traces are kept, empty: none are.

    What is measured is kept in a file without a name in `folder`; None: in the folder of temporary files. If a system
    was started for the observation, the observation ends with that system. Raises TargetError if there is nothing to
    observe or the target cannot be observed; TargetRebooted and KeyboardInterrupt only before something was seen. After
    that the result is returned, whatever ends the observation.
    """
    if nothing := watched.why_nothing(plan):
        raise TargetError(f"{link.target.address}: {nothing}")
    roster = Roster(watched.found, watched.left_out)
    flows: FlowAccumulator | None = None
    figures: LiveFigures | None = None
    began, finished, broken = Began(placed=(), refused=()), None, ""
    cut_off: BaseException | None = None
    result: ObservationResult | None = None
    late = LateValueRecord(trace, kernel_trace.read_symbols(link), folder) if trace else None
    start_time, gone_ns, until_ns = now().isoformat(), 0, 0
    stream = session.observe(
        link,
        scripts,
        watched.placement,
        watched.found,
        for_s=plan.for_s,
        kernel_events=[event for event in kernel_trace.read_events() if event not in _FOR_PEOPLE] if late else (),
        loops=watched.loops,
        limit_per_s=session.LIMIT_PER_S + (_KERNEL_EVENTS_PER_S if late else 0),
    )
    try:
        for observed in stream:
            if isinstance(observed, Began):
                began = observed
            elif isinstance(observed, Finished):
                finished, broken = observed, observed.broken
            elif observed.begin_ns:
                if flows is None or figures is None:
                    flows = FlowAccumulator(
                        begin_ns=observed.begin_ns,
                        paths=plan.followed,
                        recorder=onlooker.recorder,
                        on_turn=late.turn if late else None,
                        store=RowStore(folder),
                        loops=watched.loops,
                    )
                    if watched.loops is None and plan.loops:
                        flows.loops.missing[NO_ADDRESSES] = None
                    flows.observe(roster.alive)
                    figures = LiveFigures(flows, plan.deadlines, late.look if late else None)
                for pid in observed.ended:
                    roster.end(pid)
                for program in observed.programs:
                    roster.begin(program.program)
                if observed.ended or observed.programs:
                    flows.observe(roster.alive)
                for reading in observed.clocks:
                    flows.offset(*reading)
                if late is not None:
                    late.record(observed)
                flows.feed([*observed.hits, *observed.gaps])
                flows.loops.feed(observed.kernel, observed.gaps, observed.realtime_offset_ns)
                until_ns = observed.until_ns
                onlooker.on_second(figures.snapshot(observed.until_ns))
                if late is not None:
                    late.cut(observed.until_ns)
                gone_ns = 0 if roster.alive else gone_ns or observed.until_ns
                if plan.system.start and gone_ns and observed.until_ns - gone_ns > GONE_NS:
                    break
    except NoRoom as error:
        broken = str(error)
    except KeyboardInterrupt as error:
        if flows is None:
            raise
        if not onlooker.is_attended:
            cut_off, broken = error, "rtrun was interrupted"
    except TargetRebooted as error:
        if flows is None:
            raise
        cut_off, broken = None if onlooker.is_attended else error, str(error)
    except Exception as error:
        if flows is None or figures is None:
            raise
        cut_off, broken = error, defect_in_words(error)
    finally:
        if flows is None or figures is None:
            stream.close()
    if flows is None or figures is None:
        raise TargetError(f"{link.target.address}: the probes were placed, but nothing was recorded")
    try:
        with deferred(KEPT_FIRST):
            # This waits until the probes are taken off.
            stream.close()
            flows.finish(until_ns)
            asked_ns = round(plan.for_s * 1e9)
            if late is not None:
                figures.snapshot(flows.newest_ns)
                late.cut(flows.newest_ns + AFTER_NS)
            # An observation that was read to its end has missed nothing after its last event.
            is_whole = finished and finished.is_clean and not broken
            result = ObservationResult(
                flows=flows,
                programs=roster.seen,
                programs_left_out=roster.left_out,
                began=began,
                finished=finished,
                start_time=start_time,
                end_time=now().isoformat(),
                coverage=coverage(
                    begin_ns=flows.begin_ns,
                    until_ns=flows.begin_ns + asked_ns if is_whole else flows.until_ns,
                    asked_ns=asked_ns,
                    gaps=flows.gaps,
                ),
                broken=broken,
                cut_off=cut_off,
                late=late,
            )
    except KeyboardInterrupt as error:
        if result is None:
            raise
        return replace(result, cut_off=error)
    return result


def defect_in_words(error: Exception) -> str:
    """Describe an error that is not the target's: a defect of ours, or this machine is out of resources."""
    return f"rtrun itself failed: {type(error).__name__}{f': {error}' if str(error) else ''}"[:300]
