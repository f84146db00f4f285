"""The traced outliers of a run, each with the cut of its lateness."""

import gc
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtfiles.output import counted
from rtfiles.untrusted import whole_number
from rtrun.causes.control import Windows, control_ns, windows_before
from rtrun.causes.cut import cut
from rtrun.causes.events import Callback, Context
from rtrun.causes.ftrace import Trace, has_lines, read_ends, read_trace, refuse_trace_cmd
from rtrun.causes.group_limits import limits, uses_up_quota, with_groups
from rtrun.causes.parts import Part
from rtrun.causes.reconstruction import reconstruct
from rtrun.causes.steps import Step, steps
from rtrun.causes.timeline import IDLE_PID, Span, State, Timeline
from rtrun.plan.suites import kind_of, suite
from rtrun.results.output import NON_MEASURING_THREADS, Record
from rtrun.results.record import RunRecord, check_file

# How much is read after an outlier: the trace must show that the measuring thread continued.
AFTER_NS = 10_000_000
# How much is read before an outlier at least. If a thread slept for longer, only its wake-up is seen.
BEFORE_NS = 50_000_000
AROUND = 4
HEAD_BYTES_MAX = 8192  #: the first line of a kernel trace, as read
_HEAD = re.compile(
    r"# \S{1,255}: (\d{1,18}) ns at index (\d{1,18}) above \d{1,18} ns, at (\d{1,9})\.(\d{6}) s of (\w{1,40})"
    r"(?: by thread (\d{1,10}))?\n",
    re.ASCII,
)
_SHARED = re.compile(r"# in (\S{1,255})\n", re.ASCII)
NOT_RECORDED = (
    "the trace holds nothing of that moment: it was overwritten, or recording was paused while another was copied "
    "(a kernel without CONFIG_TRACER_SNAPSHOT)"
)

EMPTY = "the trace is empty: the kernel recorded no event, or what was recorded was gone when it was copied"
NO_TIMES = "the trace has no line with a time in seconds: another clock (trace_clock counter or x86-tsc), or no trace"
# Recording never pauses this long, and no buffer reaches back this far.
ANOTHER_CLOCK_NS = 3600 * 10**9


@dataclass(frozen=True, kw_only=True, slots=True)
class Outlier:
    """A value above the limit of the run, its time on the clock of the samples, and the file that has its trace.

    `tid` is the thread that received it, if the trace names one.
    """

    run: str
    output: str
    index: int
    value_ns: int
    at_ns: int
    clock: str
    trace: str
    tid: int | None = None

    @property
    def due_ns(self) -> int:
        """When the value would have been 0."""
        return self.at_ns - self.value_ns


@dataclass(frozen=True, kw_only=True, slots=True)
class Explained:
    """An outlier, the parts of its lateness, and what happened in equally long windows when nothing was late.

    `steps` are the nanoseconds of each step of a message; empty for a timer. `around` is what each CPU did until the
    outlier; it begins `AROUND` times the value before the due time. `idle_ns` is how long each other CPU was idle while
    the measured thread waited for its own. `callbacks` are the earlier callbacks of the thread, in order. `limits` are
    the limits of the run's control groups, in words. Without parts, `note` gives the reason; with parts, it states what
    is wrong with the trace, or is empty.
    """

    outlier: Outlier
    parts: tuple[Part, ...] = ()
    control: Windows
    steps: Mapping[Step, int] = field(default_factory=dict)
    around: Mapping[int, tuple[Span, ...]] = field(default_factory=dict)
    idle_ns: Mapping[int, int] = field(default_factory=dict)
    callbacks: tuple[Callback, ...] = ()
    limits: tuple[str, ...] = ()
    note: str = ""


def explain_run(folder: Path, record: RunRecord) -> Iterator[Explained]:
    """Yield the traced outliers of a run. Raises UsageError for files that are not what they should be."""
    threads: dict[str, dict[int, str]] = {}
    outliers: list[Outlier] = []
    for output in dict.fromkeys(record.outputs):
        names = [name for name in record.files if re.fullmatch(re.escape(output) + r"-trace-[0-9]{1,18}\.txt", name)]
        if not names:
            continue
        for name in (*names, f"{output}.json"):
            check_file(folder, record, name)
        threads[output] = _threads(folder / f"{output}.json")
        outliers += (_read_head(folder, record.run, output, name) for name in names)
    outliers.sort(key=lambda outlier: outlier.at_ns)
    kind = kind_of(record.suite)
    is_message = kind is not None and kind.has_steps
    # Outliers, also of several subscribers, may share a trace: it is read once.
    for name in dict.fromkeys(outlier.trace for outlier in outliers):
        if name not in record.files:
            raise UsageError(f"{folder}: a trace is in {name!r}, which is no file of the run")
        of_trace = [outlier for outlier in outliers if outlier.trace == name]
        from_ns = min(outlier.due_ns - max(control_ns(outlier.value_ns), BEFORE_NS) for outlier in of_trace)
        until_ns = max(outlier.at_ns for outlier in of_trace) + AFTER_NS
        with _without_garbage_collection():
            trace = read_trace(folder / name, from_ns=max(0, from_ns), until_ns=until_ns)
            order = reconstruct(trace.events, started=trace.started)
            every = [
                _explain(outlier, order, trace, outliers, threads[outlier.output], is_message, record)
                for outlier in of_trace
            ]
        for explained in every:
            yield explained if explained.parts else replace(explained, note=_why_none(folder / name, explained.outlier))


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Without garbage collection: a trace's many tuples form no cycles, and searching them for cycles takes a tenth of
    the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _explain(
    outlier: Outlier,
    order: Timeline,
    trace: Trace,
    all_outliers: Sequence[Outlier],
    threads: Mapping[int, str],
    is_message: bool,
    record: RunRecord,
) -> Explained:
    """Explain one outlier. `all_outliers` are those of the run: their time is never used as a control.

    `threads` are those of the measuring program. `is_message`: its values are latencies of messages.
    """
    pid = outlier.tid or _measured_thread(order, outlier.at_ns, threads)
    place = bisect_left(trace.events, (outlier.due_ns,))
    if pid is None or place == len(trace.events) or trace.events[place].at_ns > outlier.at_ns:
        return Explained(outlier=outlier, control=Windows(), note=NOT_RECORDED)
    # In a container threads are known only by name, and publisher and subscriber use the same names.
    known = pid in threads
    own = frozenset(threads) if known else _with_name(order, set(threads.values()))
    callbacks = _earlier_callbacks(outlier, order, pid, record)
    parts = cut(
        order,
        pid=pid,
        own=own,
        due_ns=outlier.due_ns,
        at_ns=outlier.at_ns,
        callbacks=callbacks,
        used_up=uses_up_quota(record),
    )
    parts = with_groups(parts, record, order.prios)
    late = [(other.due_ns, other.at_ns) for other in all_outliers]
    control = windows_before(order, trace.events, begin_ns=outlier.due_ns, length_ns=outlier.value_ns, late=late)
    begin_ns = outlier.due_ns - AROUND * outlier.value_ns
    around = {cpu: tuple(order.spans(cpu, begin_ns, outlier.at_ns)) for cpu in order.cpus}
    # The observed latency of a message ends when it is taken.
    calls_back = suite(record.suite).subject == "started"
    of_message = steps(parts, pid=pid if calls_back else None, own=own) if is_message and known else {}
    return Explained(
        outlier=outlier,
        parts=parts,
        control=control,
        steps=of_message,
        around=around,
        idle_ns=_idle_elsewhere(order, parts, pid),
        callbacks=callbacks,
        limits=limits(record),
        note=_what_is_missing(outlier, order, trace),
    )


def _earlier_callbacks(outlier: Outlier, order: Timeline, pid: int, record: RunRecord) -> tuple[Callback, ...]:
    """The callbacks of the measured thread within an outlier; empty if callbacks are what is measured."""
    kind = kind_of(record.suite)
    if kind and kind.is_of_callbacks:
        return ()
    # The outlier's time is in whole microseconds.
    until_ns = outlier.at_ns + 1000
    every = order.callbacks.get(pid, ())
    within = [callback for callback in every if outlier.due_ns < callback.at_ns <= until_ns]
    # The last callback before the outlier counts, too, if its end was not seen.
    before = [callback for callback in every if callback.took_ns is None and callback.at_ns <= outlier.due_ns][-1:]
    return (*before, *within)


def _idle_elsewhere(order: Timeline, parts: Sequence[Part], pid: int) -> Mapping[int, int]:
    """How long other CPUs were idle while a thread waited for its own: its affinity forbade a move, or it was not
    moved."""
    idle_ns: Counter[int] = Counter()
    for part in parts:
        if part.pid != pid or part.state is not State.WAITING:
            continue
        for cpu in set(order.cpus) - {part.cpu}:
            for span in order.spans(cpu, part.begin_ns, part.end_ns):
                who = span.occupant
                if who is not None and who.context is Context.THREAD and who.pid == IDLE_PID:
                    idle_ns[cpu] += span.end_ns - span.begin_ns
    return idle_ns


def _what_is_missing(outlier: Outlier, order: Timeline, trace: Trace) -> str:
    """How many events the kernel lost during an outlier, and how many lines could not be read; empty if none."""
    lost = [event.missing for event in order.lost if outlier.due_ns <= event.at_ns <= outlier.at_ns]
    known = sum(missing or 0 for missing in lost)
    notes = [f"{known} events were lost within" if known else "events were lost within"] if lost else []
    if trace.not_read:
        notes.append(f"{counted(trace.not_read, 'line')} of its trace could not be read")
    return "; ".join(notes)


def _why_none(path: Path, outlier: Outlier) -> str:
    """Why a trace does not show an outlier."""
    ends = read_ends(path)
    if ends is None:
        return NO_TIMES if has_lines(path) else EMPTY
    if ends[0] - ANOTHER_CLOCK_NS < outlier.at_ns < ends[1] + ANOTHER_CLOCK_NS:
        return NOT_RECORDED
    hours = abs(ends[0] - outlier.at_ns) / 3600e9
    return f"the trace is of another clock than {outlier.clock}, which is {hours:.0f} h away from it"


def _with_name(order: Timeline, names: set[str]) -> frozenset[int]:
    return frozenset(pid for pid, name in order.names.items() if name in names)


def _measured_thread(order: Timeline, at_ns: int, threads: Mapping[int, str]) -> int | None:
    """The thread that measured the value: a thread of the program that ran then, by id, or by name in a container.

    If several ran, it is the main thread, the first of `threads`. It measures everything except one-shots, for which it
    waits.
    """
    ran = [
        span
        for cpu in order.cpus
        for span in order.spans(cpu, at_ns - 1000, at_ns + 1000)
        if span.occupant and span.occupant.context is Context.THREAD
    ]
    pids = [span.occupant.pid for span in sorted(ran, key=lambda span: -span.end_ns) if span.occupant]
    main = next(iter(threads), None)
    by_id = sorted((pid for pid in pids if pid in threads), key=lambda pid: pid != main)
    by_name = [pid for pid in pids if pid in _with_name(order, set(threads.values()))]
    return next(iter(by_id or by_name), None)


def _threads(path: Path) -> dict[int, str]:
    """The threads of the program that measure, or work for a measuring thread."""
    threads = read_json(path, Record).in_effect.threads
    return {thread.tid: thread.name for thread in threads if thread.name not in NON_MEASURING_THREADS}


def _read_head(folder: Path, run: str, output: str, name: str) -> Outlier:
    path = folder / name
    refuse_trace_cmd(path)
    try:
        with path.open("rb") as stream:
            first, second = (stream.readline(HEAD_BYTES_MAX).decode("utf-8", errors="replace") for _ in range(2))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    match = _HEAD.fullmatch(first)
    if match is None:
        raise UsageError(f"{path}: its first line does not name an outlier, as the suites write it: {first[:80]!r}")
    shared = _SHARED.fullmatch(second)
    return Outlier(
        run=run,
        output=output,
        index=whole_number(match[2]),
        value_ns=whole_number(match[1]),
        at_ns=whole_number(match[3]) * 1_000_000_000 + whole_number(match[4]) * 1000,
        clock=match[5],
        trace=shared[1] if shared else name,
        tid=whole_number(match[6]) if match[6] else None,
    )
