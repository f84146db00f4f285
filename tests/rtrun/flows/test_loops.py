"""Loops from events that are made up: gaps, what a hostile kernel may print, and the grid of due times."""

import struct

import numpy as np
import pytest
from made_flows import MS, S, program

from rtrun.flows.loops import LoopRecord
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.rows import RowStore
from rtrun.plan.observation import ObservationPlan, read_stream_deadline
from rtrun.probes.formats import EventFormat
from rtrun.probes.hits import Gap, GapCause, ProgramThread
from rtrun.probes.kernel_events import WaitingEvents
from rtrun.probes.loops import EVENTS, EXPIRY, FUNCTIONS, SLEEP, START, SWITCH, WAKING, LoopWatch

WAKEUP, TIMERFD = 0xFFFFFFFF_81000000, 0xFFFFFFFF_81000100
TID, OTHER = 8, 9
COMMON = "".join(
    f"\tfield:{kind} common_{name};\toffset:{offset};\tsize:{size};\tsigned:{signed};\n"
    for kind, name, offset, size, signed in (
        ("unsigned short", "type", 0, 2, 0),
        ("unsigned char", "flags", 2, 1, 0),
        ("unsigned char", "preempt_count", 3, 1, 0),
        ("int", "pid", 4, 4, 1),
    )
)
FIELDS = {
    START: (("hrtimer", 8, 0), ("function", 8, 0), ("softexpires", 8, 1)),
    EXPIRY: (("hrtimer", 8, 0), ("function", 8, 0)),
    WAKING: (("pid", 4, 1),),
    SWITCH: (("prev_pid", 4, 1), ("next_pid", 4, 1), ("prev_state", 8, 1)),
}


def form(number, name, fields):
    text, offset = f"name: {name.rpartition('/')[2]}\nID: {number}\nformat:\n{COMMON}\n", 8
    for field, size, signed in fields:
        text += f"\tfield:long {field};\toffset:{offset};\tsize:{size};\tsigned:{signed};\n"
        offset += size
    return EventFormat(text)


class Kernel:
    """Events in the order in which they are made, as the reader of a trace passes them on."""

    def __init__(self, **fields):
        self.kinds = [
            (name, form(at, name, fields.get(name.rpartition("/")[2], FIELDS[name]))) for at, name in enumerate(EVENTS)
        ]
        self.waiting = WaitingEvents(self.kinds)

    def add(self, at_ns, name, *numbers, tid=OTHER, flags=0, cpu=0):
        kind = EVENTS.index(name)
        codes = "".join({4: "iI", 8: "qQ"}[size][not signed] for _, size, signed in FIELDS[name])
        self.waiting.add(at_ns, cpu, 0, tid, kind, struct.pack(f"<HBBi{codes}", kind, flags, 0, tid, *numbers))

    def cycle(self, due_ns, late_ns=50_000, *, run_ns=100_000, step_ns=MS, soft_ns=None):
        """The thread is woken for a time, runs, asks for the next time and sleeps."""
        at_ns = due_ns + late_ns
        self.add(due_ns + 1000, EXPIRY, 0xA0, WAKEUP)
        self.add(due_ns + 2000, WAKING, TID, flags=8)
        self.add(at_ns, SWITCH, OTHER, TID, 0)
        self.add(at_ns + run_ns, START, 0xA0, WAKEUP, due_ns + step_ns if soft_ns is None else soft_ns, tid=TID)
        self.add(at_ns + run_ns, SWITCH, TID, OTHER, 1, tid=TID)

    def taken(self):
        return self.waiting.cut(10**15, [])


def loop_record(name="loop:arm=1ms", threads=((TID, "FIFO"),)):
    plan = ObservationPlan(for_s=1, deadlines=[read_stream_deadline(name)])
    record = LoopRecord(
        ObservationState(0, RowStore()), LoopWatch(names=plan.loops, functions={WAKEUP: SLEEP, TIMERFD: FUNCTIONS[1]})
    )
    record.observe([running(threads)])
    return record


def running(threads, pid=7, name="arm"):
    program_threads = [
        ProgramThread(tid=tid, name="worker", policy=policy, priority=50, cpus=()) for tid, policy in threads
    ]
    template = program(pid)
    return type(template)(
        **{key: getattr(template, key) for key in template.__slots__}
        | {"threads": tuple(program_threads), "file": name}
    )


def log_of(record):
    (log,) = (log for log in record.logs.values() if log.is_shown)
    return log


def fed(record, kernel, gaps=(), offset_ns=None):
    record.feed(kernel.taken(), gaps, offset_ns)
    return log_of(record)


def test_each_cycle_has_a_lateness_and_a_response():
    record, kernel = loop_record(), Kernel()
    for number in range(20):
        kernel.cycle(S + number * MS, late_ns=10_000 * (number + 1))
    log = fed(record, kernel)
    record.finish()
    # The first time was asked for before anything was seen.
    due, interrupt, waking, ran = log.rows.read().T
    assert due.tolist() == [S + number * MS for number in range(1, 20)]
    assert (ran - due).tolist() == [10_000 * (number + 1) for number in range(1, 20)]
    assert {*(interrupt - due).tolist()} == {1000} and {*(waking - due).tolist()} == {2000}
    begin, end, run = log.responses.read().T
    assert (begin == due).all() and (end - ran).tolist() == [100_000] * 19 and run.tolist() == [100_000] * 19
    assert log.period_ns() == MS and log.worst.late_ns == 200_000


def test_what_came_before_a_gap_is_not_joined_with_what_came_after():
    record, kernel = loop_record(), Kernel()
    for number in (*range(10), *range(15, 30)):
        kernel.cycle(S + number * MS)
    gap = Gap(S + 10 * MS, S + 14 * MS, "lost", GapCause.EVENTS_LOST)
    log = fed(record, kernel, [gap])
    due = log.rows.read()[:, 0]
    assert due.size == 23 and due[9] == S + 16 * MS
    assert not log.skipped(0, due, MS).any(), "nobody knows what ran in the gap"
    assert log.responses.read()[:, 0].max() < S + 29 * MS and not (log.responses.read()[:, 1] > S + 30 * MS).any()


def test_skipped_periods_are_counted_on_a_grid_alone():
    record, kernel = loop_record(), Kernel()
    for number in (*range(10), *range(13, 30)):
        kernel.cycle(S + number * MS, late_ns=20_000 + 777 * number, step_ns=4 * MS if number == 9 else MS)
    log = fed(record, kernel)
    due = log.rows.read()[:, 0]
    assert log.skipped(0, due, log.period_ns()).sum() == 3
    # One that sleeps for a millisecond, whenever it has run.
    record, kernel, due_ns = loop_record(), Kernel(), S
    for number in range(30):
        late_ns = 20_000 + 7919 * number % 40_000
        next_ns = due_ns + late_ns + 100_000 + MS
        kernel.cycle(due_ns, late_ns, soft_ns=next_ns)
        due_ns = next_ns
    log = fed(record, kernel)
    assert log.period_ns() is None and len(log.rows) == 29


def test_a_switch_that_is_not_recorded_makes_a_value_no_lower():
    record, kernel = loop_record(), Kernel()
    for number in range(10):
        kernel.cycle(S + number * MS)
    whole = kernel.taken()
    switches = np.flatnonzero(whole.rows["kind"] == EVENTS.index(SWITCH))
    record.feed(whole.only(np.delete(np.arange(len(whole)), switches[8])), (), None)
    late = np.diff(log_of(record).rows.read()[:, [0, 3]], axis=1)[:, 0]
    assert log_of(record).unseen == 1 and late.size == 9
    assert late[3] == 150_000 and np.delete(late, 3).max() == 50_000


def test_a_sleep_until_a_time_of_day():
    record, kernel, offset_ns = loop_record(), Kernel(), 1_700_000_000 * S
    for number in range(20):
        kernel.cycle(S + number * MS, soft_ns=S + (number + 1) * MS + offset_ns)
    log = fed(record, kernel, offset_ns=offset_ns)
    assert log.clock == "system" and (log.rows.read()[:, 3] - log.rows.read()[:, 0] == 50_000).all()
    # The clock is set: what was asked for before that is not known.
    before = len(log.rows)
    for number in range(20, 25):
        kernel.cycle(S + number * MS, soft_ns=S + (number + 1) * MS + offset_ns + S)
    assert len(fed(record, kernel, offset_ns=offset_ns + S).rows) == before
    for number in range(25, 30):
        kernel.cycle(S + number * MS, soft_ns=S + (number + 1) * MS + offset_ns + S)
    assert len(fed(record, kernel, offset_ns=offset_ns + S).rows) == before + 4


@pytest.mark.parametrize("soft_ns", [2**63 - 1, -(2**63), -1, 0])
def test_times_that_cannot_be_are_left_out(soft_ns):
    record, kernel = loop_record(), Kernel()
    for number in range(3):
        kernel.cycle(S + number * MS, soft_ns=soft_ns)
    due = fed(record, kernel).rows.read()[:, 0]
    assert ((due >= 0) & (due <= 10**18)).all()


def test_what_the_kernel_lacks_is_named():
    record, kernel = loop_record(), Kernel(hrtimer_start=(("hrtimer", 8, 0), ("function", 8, 0), ("expires", 8, 1)))
    kernel.cycle(S)
    fed(record, kernel)
    assert [*record.missing] == [
        "the kernel's event timer/hrtimer_start has no number softexpires: no loop is measured"
    ]
    record, kernel = loop_record(), Kernel()
    kernel.cycle(S)
    events = kernel.taken()
    record.feed(type(events)(events.at_ns, events.rows, events.data, events.kinds[1:]), (), None)
    assert [*record.missing] == ["the kernel has no event timer/hrtimer_start: no loop is measured"]
    record, kernel = loop_record(), Kernel()
    kernel.waiting.add(S, 0, 0, TID, 0, bytes(12))
    fed(record, kernel)
    assert [*record.missing] == ["an event timer/hrtimer_start that ends before its field hrtimer: no loop is measured"]


def test_a_named_program_means_its_real_time_threads_once_it_has_some():
    record = loop_record(threads=[(TID, "OTHER"), (OTHER, "OTHER")])
    assert [*record.logs] == [("arm", "worker"), ("arm", "worker#2")]
    record.observe([running([(TID, "OTHER"), (OTHER, "FIFO")])])
    assert [log.thread for log in record.logs.values() if log.is_shown] == ["worker#2"]
    # The real-time thread gets the name, but not the values, of the one that it takes the place of.
    record, kernel = loop_record(threads=[(TID, "OTHER")]), Kernel()
    for number in range(3):
        kernel.cycle(S + number * MS)
    assert len(fed(record, kernel).rows) == 2
    record.observe([running([(TID, "OTHER"), (OTHER, "FIFO")])])
    (log,) = (log for log in record.logs.values() if log.is_shown)
    assert log.is_real_time and record.threads[OTHER].log is log and log.thread == "worker" and not len(log.rows)


def test_no_more_threads_than_the_limit():
    record = loop_record(threads=[(tid, "FIFO") for tid in range(1000, 2000)])
    assert len(record.threads) == len(record.logs) == 100


def test_a_timer_that_expires_while_its_thread_waits_for_a_lock():
    """Whoever gives the lock back wakes the thread, not the timer; it takes note of that when it reads the timer."""
    record, kernel = loop_record(), Kernel()
    kernel.add(S, START, 0xB0, TIMERFD, S + MS, tid=TID)
    kernel.add(S + 10, SWITCH, TID, OTHER, 1, tid=TID)
    kernel.add(S + MS + 100, EXPIRY, 0xB0, TIMERFD)
    kernel.add(S + MS + 5000, WAKING, TID)
    kernel.add(S + MS + 6000, SWITCH, OTHER, TID, 0)
    kernel.add(S + MS + 9000, START, 0xB0, TIMERFD, S + 2 * MS, tid=TID)
    log = fed(record, kernel)
    assert log.rows.read().tolist() == [[S + MS, S + MS + 100, -1, S + MS + 9000]]


def test_a_thread_that_others_run_instead_of_has_not_ended_its_cycle():
    record, kernel = loop_record(), Kernel()
    kernel.cycle(S)
    kernel.cycle(S + MS)
    kernel.add(S + 2 * MS + 1000, EXPIRY, 0xA0, WAKEUP)
    kernel.add(S + 2 * MS + 2000, WAKING, TID, flags=8)
    kernel.add(S + 2 * MS + 3000, SWITCH, OTHER, TID, 0)
    kernel.add(S + 2 * MS + 4000, START, 0xA0, WAKEUP, S + 3 * MS, tid=TID)
    kernel.add(S + 2 * MS + 5000, SWITCH, TID, OTHER, 0, tid=TID)
    log = fed(record, kernel)
    record.finish()
    assert log.responses.read()[:, 0].tolist() == [S + MS]
