"""The cut of a late value: each kind of cause from a trace of a few lines, and sums that are exact for any trace."""

import re
from dataclasses import dataclass
from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st
from traced import SPECIMENS, events, line, switch, waking

from rtrun.causes.cut import cut
from rtrun.causes.parts import Kind
from rtrun.causes.reconstruction import reconstruct

ME, HOG, LOW, IDLE, OTHER = ("me", 1, 4), ("hog", 2, 1), ("low", 3, 120), ("idle", 0, 120), ("mate", 5, 4)
NORMAL, MATE = ("me", 1, 120), ("mate", 5, 120)
SENDS, TO_ME = "signal_generate: ", "errno=0 code=0 comm=me pid=1 grp=1 res=0"
BELOW, NEXT = ("below", 7, 49), ("other", 8, 0)
# The timer of a thread was due at 1000 us, and the clock of the trace is 500 us ahead of the timers' clock.
START = line(100, "hrtimer_start: hrtimer=a function=hrtimer_wakeup expires=500000 softexpires=500000")
BEFORE = START + switch(200, ME, LOW)
LOST = "CPU:0 [LOST 5 EVENTS]\n"


def expiry(us, late_us=0):
    """The interrupt of the timer, which begins at a moment, and wakes the thread 2 us later."""
    now = f"hrtimer_expire_entry: hrtimer=a function=hrtimer_wakeup now={500_000 + 1000 * late_us}"
    begin, end = line(us, "local_timer_entry: vector=236"), line(us + 3, "local_timer_exit: vector=236")
    return begin + line(us, now, flags="d.h..") + waking(us + 2, 1, flags="d.h..") + end


def called_back(us, took_us=None):
    """A callback of the measured thread that ended, or without its length one that began."""
    if took_us is None:
        return line(us, "callback_begin: name=timer of /a", name="me", pid=1)
    return line(us, f"callback_end: took_ns={took_us * 1000} name=timer of /a", name="me", pid=1)


def end(us, cpu=0):
    """The moment at which the value was measured."""
    return line(us, "x: y", cpu=cpu)


def parts_of(text, *, due=1000, at, pid=1, own=(1,), used_up=False):
    """What the lines say, as ``KIND name microseconds; ...``; what has one cause and follows each other is one."""
    order = reconstruct(events(text))
    callbacks = order.callbacks.get(pid, ())
    ends = {"due_ns": due * 1000, "at_ns": at * 1000}
    parts = cut(order, pid=pid, own=frozenset(own), callbacks=callbacks, used_up=used_up, **ends)
    assert sum(part.length_ns for part in parts) == (at - due) * 1000
    alike = groupby(parts, key=lambda part: (part.cause.kind, part.cause.name, part.cpu))
    lengths = ((kind, name, sum(part.length_ns for part in parts) // 1000) for (kind, name, _), parts in alike)
    return "; ".join(" ".join(filter(None, (kind.name, name, str(length)))) for kind, name, length in lengths)


def are(parts, expected):
    """Whether these are the parts; ``...`` stands for any."""
    return re.fullmatch(re.escape(expected).replace(r"\.\.\.", "(?:.*)"), parts) is not None


@dataclass(frozen=True)
class Case:
    """A trace, the moment at which the value was measured, its parts, the threads of the program, and its quota."""

    text: str
    at: int
    parts: str
    own: tuple[int, ...] = (1,)
    used_up: bool = False


def timed_out(*, awaited_waits):
    """The measured thread waits for its mate with a timeout, which comes 400 us after the value was due."""
    started = "hrtimer_start: hrtimer=a function=hrtimer_wakeup expires=900000 softexpires=900000"
    woken = waking(995 if awaited_waits else 1450, 5, flags="d.h..")
    return (
        line(100, started) + waking(110, 1, by=5) + switch(120, OTHER, ME) + switch(200, ME, LOW)
        + switch(900, LOW, HOG, state="R") + woken * awaited_waits + expiry(1400, late_us=400)
        + woken * (not awaited_waits) + switch(1500, HOG, OTHER) + switch(1510, OTHER, ME) + end(1520)
    )  # fmt: skip


def woken_on_an_idle_cpu(before_idle=""):
    """Real-time threads are throttled; then the CPU goes idle, and the measured thread wakes up there."""
    text = START + switch(200, ME, BELOW) + switch(900, BELOW, LOW, state="R") + before_idle + switch(960, LOW, IDLE)
    return text + expiry(1000) + switch(1400, IDLE, ME, state="R") + end(1410)


def woken_before_a_switch(event):
    """The measured thread was woken on a CPU that then goes from a thread without real-time priority to idle."""
    text = BEFORE + expiry(1000) + line(1004, f"{event}: comm=me pid=1 prio=4 target_cpu=000", flags="d.h..")
    return text + switch(1050, LOW, IDLE) + switch(1400, IDLE, ME, state="R") + end(1410)


def woken_before(cpu_1_begins_us, between=""):
    """Nobody is seen to wake the measured thread, which waits for the CPU when the trace begins."""
    text = line(1100, "x: y", name="hog", pid=2) + line(cpu_1_begins_us, "x: y", cpu=1, name="idle", pid=0) + between
    return text + switch(1400, HOG, ME) + end(1410)


def mate_without_interrupts(timer_started_us=900):
    """A thread of the program has the CPU; another timer of that CPU was due at 1050 us, and its interrupt is late."""
    tick = "hrtimer_start: hrtimer=b function=tick_sched_timer expires=550000 softexpires=550000"
    text = START + switch(200, ME, OTHER) + expiry(1000)
    text += line(timer_started_us, tick) + line(1350, "local_timer_entry: vector=236")
    text += line(1350, "hrtimer_expire_entry: hrtimer=b function=tick_sched_timer now=850000", flags="d.h..")
    text += line(1352, "local_timer_exit: vector=236") + switch(1400, OTHER, ME) + end(1410)
    return "".join(sorted(text.splitlines(keepends=True), key=lambda entry: entry[35:47]))


def of_equal(me, other):
    """Another thread has the CPU when the measured one wakes up, and for as long as it waits."""
    text = START + switch(200, me, LOW) + switch(990, LOW, other, state="R") + expiry(1000)
    return text + switch(1400, other, me) + end(1410)


def of_group(me, function, other=LOW, then="", refilled=1390):
    """The thread waits for another one until a timer of the scheduler expires, whatever that one does."""
    text = START + switch(200, me, other) + expiry(1000)
    text += line(refilled, f"hrtimer_expire_entry: hrtimer=b function={function} now=890000", flags="d.h..") + then
    return text + switch(1400, NEXT if then else other, me, state="R") + end(1410)


def stopped_while_its_mate_waits():
    """The timer wakes the mate, which waits for the hog; when it has woken the thread, both are stopped."""
    text = START + switch(150, IDLE, SENDER, cpu=1) + switch(200, OTHER, LOW) + waking(210, 1, by=5)
    text += switch(220, LOW, ME) + switch(230, ME, LOW) + switch(990, LOW, HOG, state="R")
    text += expiry(1000).replace("pid=1 ", "pid=5 ")
    text += waking(1300, 1, by=6, cpu=1) + line(1301, f"{SENDS}sig=19 {TO_ME}", cpu=1, name="sender", pid=6)
    text += switch(1400, HOG, OTHER) + switch(1410, OTHER, ME) + switch(1440, ME, IDLE, state="T")
    text += waking(1600, 1, by=6, cpu=1) + line(1601, f"{SENDS}sig=18 {TO_ME}", cpu=1, name="sender", pid=6)
    return text + switch(1650, IDLE, ME) + end(1660)


def stopped(signal):
    text = BEFORE + line(300, f"{SENDS}sig={signal} {TO_ME}", name="low", pid=3)
    text += switch(310, LOW, ME) + switch(320, ME, LOW, state="T") + switch(330, LOW, HOG)
    return text + waking(1400, 1, by=2) + switch(1402, HOG, ME, state="R") + end(1410)


def frequency(us, khz, cpu=0):
    # Another CPU may say so.
    return line(us, f"cpu_frequency: state={khz} cpu_id={cpu}", cpu=1, name="sugov:0", pid=7)


def slowed(cpu):
    text = frequency(50, 1_200_000, cpu) + BEFORE + expiry(1000) + switch(1010, LOW, ME, state="R")
    return text + frequency(1110, 300_000, cpu) + end(1510)


RUNS_AGAIN = expiry(1000) + switch(1400, LOW, ME, state="R") + end(1410)
HOG_RUNS = BEFORE + switch(990, LOW, HOG, state="R") + expiry(1000)
I_RUN = BEFORE + expiry(1000) + switch(1005, LOW, ME, state="R")
PRINTED = line(980, "console: [    1.0] Mem-Info", name="low", pid=3)
FAULT = "page_fault_user: address=0x7f ip=0x55 error_code=0x6"
ENTERED, LEFT, RAISED = (f"softirq_{what}: vec=3 [action=NET_RX]" for what in ("entry", "exit", "raise"))
SENDER, STOPPER = ("sender", 6, 120), ("migration/0", 6, 0)
EXPIRED = "INTERRUPT the timer's own 2; INTERRUPT local_timer 1"

CASES = {
    "a thread of higher priority": Case(
        HOG_RUNS + switch(1400, HOG, ME) + end(1410), 1410, f"{EXPIRED}; HIGHER hog 397; PROGRAM me 10"
    ),
    # The thread that should have handed work over waited for the CPU: it is followed.
    "a timeout is not what was waited for": Case(
        timed_out(awaited_waits=True), 1520,
        "HIGHER hog 400; INTERRUPT local_timer 3; HIGHER hog 97; OTHER_THREAD mate 10; PROGRAM me 10", own=(1, 5),
    ),
    "a timeout before there was work": Case(
        timed_out(awaited_waits=False), 1520, "OWN_SLEEP me 400; ...", own=(1, 5)
    ),
    "a thread of the same priority": Case(of_equal(ME, ("equal", 4, 4)), 1410, "...; EQUAL equal 397; ..."),
    "a thread that could not be preempted": Case(BEFORE + RUNS_AGAIN, 1410, "...; NOT_PREEMPTED low 397; ..."),
    # One at SCHED_DEADLINE has no priority to be lowered, and two of them are no threads of one priority.
    "a thread at SCHED_DEADLINE": Case(of_equal(ME, ("control", 2, -1)), 1410, "...; DEADLINE control 397; ..."),
    "two at SCHED_DEADLINE": Case(
        of_equal(("me", 1, -1), ("control", 2, -1)), 1410, "...; DEADLINE control 397; ..."
    ),
    # Nobody throttles, and none is above the other: the scheduler chose one of a lower weight, the same, and a higher.
    "threads without a real-time policy share the CPU": Case(
        START + switch(200, NORMAL, LOW) + expiry(1000) + switch(1010, LOW, NORMAL, state="R")
        + switch(1020, NORMAL, ("nice", 7, 130), state="R")
        + switch(1200, ("nice", 7, 130), ("same", 8, 120), state="R")
        + switch(1300, ("same", 8, 120), ("weighty", 5, 100), state="R")
        + switch(1400, ("weighty", 5, 100), NORMAL, state="R") + end(1410),
        1410, "...; SHARED nice 180; SHARED same 100; SHARED weighty 100; PROGRAM me 10",
    ),
    "interrupts off in one of a higher weight": Case(
        START + switch(200, NORMAL, ("weighty", 5, 100)) + expiry(1300, late_us=300)
        + switch(1304, ("weighty", 5, 100), NORMAL, state="R") + end(1310),
        1310, "TIMER_LATE weighty 300; ...",
    ),
    # It is given the CPU as soon as its control group has time again: what others ran meanwhile took none of it.
    "the quota of a control group beside others": Case(
        of_group(NORMAL, "sched_cfs_period_timer"), 1410, "...; GROUP 397; ..."
    ),
    "the budget of a control group beside its equals": Case(
        of_group(ME, "sched_rt_period_timer", other=("equal", 4, 4)), 1410, "...; THROTTLED equal 397; ..."
    ),
    # Where a quota was used up, those who waited before may come first.
    "a quota that was used up": Case(
        of_group(NORMAL, "sched_cfs_period_timer", then=switch(1320, LOW, NEXT, state="R"), refilled=1310), 1410,
        "...; GROUP 317; HIGHER other 80; PROGRAM me 10", used_up=True,
    ),
    "a refill in the middle of a wait": Case(
        of_group(NORMAL, "sched_cfs_period_timer", then=switch(1320, LOW, NEXT, state="R"), refilled=1250), 1410,
        "...; SHARED low 317; ...", used_up=True,
    ),
    "a disk that is waited for": Case(
        I_RUN + switch(1010, ME, LOW, state="D") + line(1390, "irq_handler_entry: irq=53 name=disk", flags="d.h..")
        + waking(1395, 1, flags="d.h..") + line(1398, "irq_handler_exit: irq=53 ret=handled", flags="d.h..")
        + switch(1400, LOW, ME) + end(1410),
        1410, "...; PROGRAM me 5; BLOCKED interrupt 53 disk 385; INTERRUPT 53 disk 3; ...",
    ),
    "a lock of a thread whose quota was used up": Case(
        START + switch(200, NORMAL, MATE) + expiry(1000) + switch(1005, MATE, NORMAL, state="R")
        + line(1010, "sys_futex(uaddr: 0x7f, op: 0x80, val: 2, utime: 0)", name="me", pid=1)
        + switch(1011, NORMAL, LOW)
        + line(1390, "hrtimer_expire_entry: hrtimer=b function=sched_cfs_period_timer now=890000", flags="d.h..")
        + switch(1391, LOW, MATE, state="R") + waking(1400, 1, by=5) + switch(1402, MATE, NORMAL) + end(1410),
        1410, "...; PROGRAM me 6; GROUP 380; LOCK mate 9; OTHER_THREAD mate 2; PROGRAM me 8",
        own=(1, 5),
    ),
    "the budget of others": Case(of_group(NORMAL, "sched_rt_period_timer"), 1410, "...; SHARED low 397; ..."),
    "another one comes first": Case(
        of_group(NORMAL, "sched_cfs_period_timer", then=switch(1395, LOW, NEXT, state="R")), 1410, "...; SHARED ...",
    ),
    # As a shell does: the child has its parent's name until it runs another program.
    "a process that is started anew": Case(
        BEFORE + switch(990, LOW, ("sh", 2, 1), state="R") + expiry(1000) + switch(1400, ("job17", 2, 1), ME)
        + end(1410),
        1410, f"{EXPIRED}; HIGHER job17 397; PROGRAM me 10",
    ),
    # A thread of lower priority was chosen although the measured one could run.
    "throttling": Case(
        HOG_RUNS + switch(1100, HOG, LOW, state="R") + switch(1400, LOW, ME, state="R") + end(1410),
        1410, f"{EXPIRED}; HIGHER hog 97; THROTTLED low 300; PROGRAM me 10",
    ),
    # When the thread woke up, one of lower priority had been chosen instead of another real-time thread.
    "throttling that began before": Case(
        START + switch(200, ME, BELOW) + switch(900, BELOW, ("other", 8, 120), state="R")
        + switch(950, ("other", 8, 120), LOW) + RUNS_AGAIN,
        1410, "...; THROTTLED low 397; ...",
    ),
    # No thread but real-time ones could go on: the CPU is idle until they may.
    "throttling of a CPU that is left idle": Case(woken_on_an_idle_cpu(), 1410, "...; THROTTLED idle 397; ..."),
    "a thread that went to another CPU was not passed over": Case(
        woken_on_an_idle_cpu(line(950, "sched_migrate_task: comm=below pid=7 prio=49 orig_cpu=0 dest_cpu=1")),
        1410, "...; IDLE_EXIT 397; ...",
    ),
    "nor one that already runs there": Case(
        woken_on_an_idle_cpu(end(940, cpu=1) + switch(950, OTHER, BELOW, cpu=1)), 1410, "...; IDLE_EXIT 397; ..."
    ),
    "nor one that may have gone among lost events": Case(
        woken_on_an_idle_cpu(LOST), 1410, "...; IDLE_EXIT 397; ..."
    ),
    "throttling when the CPU goes idle although the thread is on its queue": Case(
        woken_before_a_switch("sched_wakeup"), 1410, "...; THROTTLED idle 350; ..."
    ),
    "a thread that is not yet on the queue was not passed over": Case(
        woken_before_a_switch("sched_stat_x"), 1410, "...; IDLE_EXIT 350; ..."
    ),
    "interrupts off": Case(
        BEFORE + expiry(1300, late_us=300) + switch(1304, LOW, ME, state="R") + end(1310),
        1310, "TIMER_LATE low 300; INTERRUPT the timer's own 2; ...",
    ),
    # Interrupts were off, or the CPU was not run: the thread may be innocent.
    "a thread of the program while no interrupt came": Case(
        mate_without_interrupts(), 1410,
        f"{EXPIRED}; OTHER_THREAD mate 47; TIMER_LATE mate 300; INTERRUPT local_timer 2; OTHER_THREAD mate 48; "
        "PROGRAM me 10",
        own=(1, 5),
    ),
    "a timer that was started too late did not wait for interrupts": Case(
        mate_without_interrupts(timer_started_us=1300), 1410,
        f"{EXPIRED}; OTHER_THREAD mate 297; TIMER_LATE mate 50; INTERRUPT local_timer 2; ...", own=(1, 5),
    ),
    "an idle state": Case(
        START + switch(200, ME, IDLE) + expiry(1300, late_us=300) + switch(1350, IDLE, ME, state="R") + end(1360),
        1360, f"TIMER_LATE idle 300; {EXPIRED}; IDLE_EXIT 47; PROGRAM me 10",
    ),
    # Seen of a virtual machine: of one CPU no event of its idle thread is recorded. The hog has run since some time
    # between its wake and its first line.
    "a CPU that leaves its idle state without a word": Case(
        START + switch(200, ME, IDLE) + waking(980, 2, by=0, flags="d.h2.") + expiry(1000)
        + line(1100, "x: y", name="hog", pid=2) + switch(1400, HOG, ME) + end(1410),
        1410, f"{EXPIRED}; UNEXPLAINED events are missing 97; HIGHER hog 300; PROGRAM me 10",
    ),
    "the last lines of a thread that leaves the CPU idle": Case(
        START + switch(200, ME, IDLE) + line(201, "x: y", name="me", pid=1) + expiry(1300, late_us=300)
        + switch(1350, IDLE, ME, state="R") + end(1360),
        1360, f"TIMER_LATE idle 300; {EXPIRED}; IDLE_EXIT 47; PROGRAM me 10",
    ),
    "an interrupt and a softirq before the thread runs": Case(
        BEFORE + line(950, "irq_handler_entry: irq=53 name=eth0")
        + line(1200, "irq_handler_exit: irq=53 ret=handled") + expiry(1200, late_us=200)
        + line(1203, ENTERED, flags="..s..") + line(1300, LEFT, flags="..s..")
        + switch(1301, LOW, ME, state="R") + end(1310),
        1310, f"INTERRUPT 53 eth0 200; {EXPIRED}; SOFTIRQ NET_RX 97; NOT_PREEMPTED low 1; PROGRAM me 9",
    ),
    "timer slack": Case(
        START.replace("=500000 soft", "=550000 soft") + switch(200, ME, LOW) + expiry(1050, late_us=50)
        + switch(1060, LOW, ME, state="R") + end(1070),
        1070, "TIMER_SLACK 50; ...",
    ),
    # The system call futex with FUTEX_WAIT says that it was a lock.
    "a lock held by another thread": Case(
        I_RUN + line(1010, "sys_futex(uaddr: 0x7f, op: 0x80, val: 2, utime: 0)", name="me", pid=1)
        + switch(1011, ME, LOW) + waking(1400, 1, by=3) + switch(1402, LOW, ME, state="R") + end(1410),
        1410, "...; PROGRAM me 6; LOCK low 389; NOT_PREEMPTED low 2; PROGRAM me 8",
    ),
    # By who stopped it, rather than by who let it go on; another signal stops nothing.
    "a program that was stopped": Case(stopped(19), 1410, "STOPPED low 400; ..."),
    "a program that was stopped by nobody who is seen": Case(stopped(10), 1410, "LET_GO_ON hog 400; ..."),
    "a program that was stopped by another one before": Case(
        line(10, f"{SENDS}sig=19 {TO_ME}", name="hog", pid=2) + switch(20, ME, LOW, state="T") + waking(90, 1, by=3)
        + switch(95, LOW, ME) + stopped(10),
        1410, "LET_GO_ON hog 400; ...",
    ),
    "a thread that hands work over, and then stops another program": Case(
        switch(150, IDLE, SENDER, cpu=1) + switch(200, ME, LOW) + waking(1200, 1, by=6, cpu=1)
        + line(1390, f"{SENDS}sig=19 {TO_ME.replace('pid=1 ', 'pid=7 ')}", cpu=1, name="sender", pid=6)
        + switch(1400, LOW, ME) + end(1410),
        1410, "OTHER_THREAD sender 200; NOT_PREEMPTED low 200; PROGRAM me 10",
    ),
    # It waits for a mate, who waits for a CPU: who wakes it to stop it has handed no work over.
    "a signal that stops is not what was waited for": Case(
        stopped_while_its_mate_waits(), 1660,
        "...; HIGHER hog 397; OTHER_THREAD mate 10; PROGRAM me 30; STOPPED sender 160; ...", own=(1, 5),
    ),
    # Its timer had not expired: the lock was given free before.
    "a thread that woke another in time did not freeze it": Case(
        START.replace("=500000", "=900000") + switch(200, ME, LOW) + waking(1300, 1, by=3) + switch(1302, LOW, ME)
        + end(1310),
        1310, "OTHER_THREAD low 300; NOT_PREEMPTED low 2; PROGRAM me 8",
    ),
    "a page fault that waits for memory": Case(
        I_RUN + line(1010, FAULT, name="me", pid=1) + switch(1011, ME, LOW, state="D") + waking(1400, 1, by=3)
        + switch(1402, LOW, ME, state="R") + end(1410),
        1410, "...; FAULT low 389; ...",
    ),
    # Each is short, and they follow each other; the last one is too far away to be one of them.
    "page faults while it runs": Case(
        I_RUN + "".join(line(us, FAULT, name="me", pid=1) for us in (1010, 1030, 1050, 1090, 1200)) + end(1210),
        1210, "...; PROGRAM me 5; FAULT me 80; PROGRAM me 120",
    ),
    # The timer wakes a thread of the program, which wakes the measured one for the callback.
    "a thread of the middleware is followed": Case(
        START + switch(200, OTHER, LOW) + switch(300, LOW, ME, state="R") + switch(310, ME, LOW)
        + expiry(1000).replace("pid=1 ", "pid=5 ") + switch(1200, LOW, OTHER, state="R")
        + waking(1250, 1, by=5) + switch(1260, OTHER, ME) + end(1270),
        1270, f"{EXPIRED}; NOT_PREEMPTED low 197; OTHER_THREAD mate 60; PROGRAM me 10", own=(1, 5),
    ),
    # The softirq of the loopback device runs in the sender, which had to wait for another thread.
    "a message is followed to its sender": Case(
        switch(100, ME, IDLE, cpu=1) + switch(900, SENDER, HOG, state="R") + switch(1300, HOG, SENDER)
        + line(1310, RAISED, name="sender", pid=6) + line(1311, ENTERED, name="sender", pid=6, flags="..s..")
        + waking(1320, 1, by=6, target=1, flags="..s..") + line(1321, LEFT, name="sender", pid=6, flags="..s..")
        + switch(1350, IDLE, ME, state="R", cpu=1) + end(1360, cpu=1) + end(1360),
        1360, "HIGHER hog 300; OTHER_THREAD sender 11; SOFTIRQ NET_RX 9; IDLE_EXIT 30; PROGRAM me 10",
    ),
    # It waits for the hog on CPU 0, then for an idle CPU 1 to wake up.
    "a migration while it waits": Case(
        line(50, "x: y", cpu=1, name="idle", pid=0) + HOG_RUNS
        + line(1100, "sched_migrate_task: comm=me pid=1 prio=4 orig_cpu=0 dest_cpu=1", name="hog", pid=2)
        + switch(1150, IDLE, ME, state="R", cpu=1) + end(1160, cpu=1),
        1160, f"{EXPIRED}; HIGHER hog 97; IDLE_EXIT 50; PROGRAM me 10",
    ),
    "lost events are unexplained": Case(
        HOG_RUNS + LOST + switch(1400, HOG, ME) + end(1410), 1410, "...; UNEXPLAINED events are missing 397; ..."
    ),
    # It began to run 60 us ago, and slept within the callback: who had the CPU then, and who is named else, stays.
    "an earlier callback of its thread": Case(
        switch(900, LOW, ME) + switch(1050, ME, HOG, state="R") + switch(1100, HOG, ME) + called_back(1350, 400)
        + called_back(1390, 20) + end(1400),
        1400,
        "CALLBACK timer of /a 50; HIGHER hog 50; CALLBACK timer of /a 250; PROGRAM me 20; "
        "CALLBACK timer of /a 20; PROGRAM me 10",
    ),
    "a callback that sleeps": Case(
        (BEFORE + expiry(1300)).replace("500000", "800000") + switch(1304, LOW, ME) + called_back(1308, 500)
        + end(1310),
        1310, "CALLBACK timer of /a ...; PROGRAM me 2",
    ),
    # What it ran may be of it; before, there is no callback.
    "a callback whose end is not seen": Case(
        switch(900, LOW, ME) + called_back(1100) + end(1400),
        1400, "PROGRAM me 100; CALLBACK timer of /a (its end is not known) 300",
    ),
    "a trace that begins too late": Case(switch(1400, HOG, ME) + end(1410), 1410, "UNEXPLAINED 400; PROGRAM me 10"),
    # It waited from when every CPU is in the trace: before that, one that is not may have woken it.
    "a thread that was woken before the trace begins": Case(
        woken_before(1090), 1410, "UNEXPLAINED before the trace begins 100; HIGHER hog 300; PROGRAM me 10"
    ),
    "a CPU that is in the trace later": Case(
        woken_before(1200), 1410, "UNEXPLAINED before the trace begins 200; HIGHER hog 200; PROGRAM me 10"
    ),
    "a wake-up may be among lost events": Case(
        woken_before(1090, "CPU:1 [LOST 5 EVENTS]\n" + line(1250, "x: y", cpu=1, name="idle", pid=0)),
        1410, "UNEXPLAINED 250; HIGHER hog 150; PROGRAM me 10",
    ),
    # Nobody is seen to wake it, and no CPU has an event for 20 ms: recording was paused.
    "a wake-up while recording was paused": Case(
        BEFORE + end(300) + switch(21_300, LOW, HOG, state="R") + switch(21_400, HOG, ME) + end(21_410), 21_410,
        "UNEXPLAINED 20300; HIGHER hog 100; PROGRAM me 10",
    ),
    "a new thread did not wait since the trace began": Case(
        woken_before(
            1090,
            waking(1150, 5, cpu=1)
            + line(1300, "sched_wakeup_new: comm=me pid=1 prio=4 target_cpu=000", cpu=1, name="idle", pid=0),
        ),
        1410, "...; HIGHER hog 100; PROGRAM me 10",
    ),
    # Also where another thread, as with PREEMPT_RT, or an interrupt ran within it; not in other threads.
    "a softirq that began before the trace is known by its end": Case(
        line(900, "x: y", name="hog", pid=2) + waking(990, 1, flags="d.h..") + switch(1100, HOG, NEXT, state="R")
        + switch(1150, NEXT, HOG) + line(1200, "irq_handler_entry: irq=53 name=eth0")
        + line(1210, "irq_handler_exit: irq=53 ret=handled") + line(1300, LEFT, name="hog", pid=2, flags="..s..")
        + switch(1400, HOG, ME) + end(1410),
        1410,
        "SOFTIRQ NET_RX 100; HIGHER other 50; SOFTIRQ NET_RX 50; INTERRUPT 53 eth0 10; SOFTIRQ NET_RX 90; "
        "HIGHER hog 100; PROGRAM me 10",
    ),
    "a softirq that began among lost events is known by its end": Case(
        BEFORE + waking(990, 1, flags="d.h..") + end(1000) + LOST + line(1100, "x: y", name="other", pid=8)
        + switch(1150, NEXT, HOG) + line(1300, LEFT, name="hog", pid=2, flags="..s..") + switch(1400, HOG, ME)
        + end(1410),
        1410, "UNEXPLAINED events are missing 150; SOFTIRQ NET_RX 150; HIGHER hog 100; PROGRAM me 10",
    ),
    # The line is in the ring before the thread writes it to the console.
    "printk to a console with interrupts off": Case(
        BEFORE + PRINTED + expiry(1300, late_us=300) + switch(1304, LOW, ME, state="R") + end(1310),
        1310, "CONSOLE low 300; ...",
    ),
    "printk to a console with preemption off": Case(BEFORE + PRINTED + RUNS_AGAIN, 1410, "...; CONSOLE low 397; ..."),
    "what a thread printed before it slept is not to blame": Case(
        START + switch(150, ME, LOW) + line(160, "console: [    1.0] x", name="low", pid=3)
        + switch(170, LOW, IDLE) + switch(180, IDLE, LOW) + RUNS_AGAIN,
        1410, "...; NOT_PREEMPTED low 397; ...",
    ),
    # The thread that stops the CPU has a priority above every other: to blame with interrupts off as well as on.
    "stop_machine": Case(
        BEFORE + switch(990, LOW, STOPPER, state="R") + expiry(1300, late_us=300) + switch(1400, STOPPER, ME)
        + end(1410),
        1410, f"HIGHER migration/0 300; {EXPIRED}; HIGHER migration/0 97; PROGRAM me 10",
    ),
    # At a quarter of it the thread takes four times as long; what it waits for takes no longer.
    "a governor that reduces the frequency": Case(
        slowed(cpu=0), 1510, "...; PROGRAM me 200; SLOWED below 1200 MHz 300"
    ),
    "a governor of another CPU": Case(slowed(cpu=1), 1510, "...; PROGRAM me 500"),
    "the frequency rises while a thread runs": Case(
        frequency(50, 600_000) + BEFORE + expiry(1000) + switch(1010, LOW, ME, state="R")
        + frequency(1110, 1_200_000) + end(1210),
        1210, "...; PROGRAM me 50; SLOWED below 1200 MHz 50; PROGRAM me 100",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_parts_of_a_late_value(case):
    parts = parts_of(case.text, at=case.at, own=case.own, used_up=case.used_up)
    assert are(parts, case.parts), parts


def test_a_thread_that_is_not_in_the_trace():
    assert parts_of(switch(1400, HOG, LOW), at=1410, pid=77) == "UNEXPLAINED 410"


# Of real traces: when the value was due, when the thread ran again, the thread, and what was done to it.
HELD = {
    "stopped.txt": (6629_084355, 6629_107280, 15232, Kind.STOPPED),
    "frozen-v1.txt": (6631_720061, 6631_761390, 15560, Kind.FROZEN),
    "frozen-v2.txt": (6634_134046, 6634_169140, 16029, Kind.FROZEN),
}


@pytest.mark.parametrize("name", HELD)
def test_a_program_that_is_stopped_or_frozen(name):
    """Whoever did it is named, and not followed to what it did before; also where the buffer lost what came before."""
    due, at, pid, kind = HELD[name]
    lines = (SPECIMENS / name).read_text().splitlines(keepends=True)
    texts = ["".join(lines)]
    if name != "frozen-v1.txt":
        begin = next(place for place, text in enumerate(lines) if "=lab_stopper" in text and place > len(lines) - 30)
        texts.append("".join(text for text in lines[begin:] if "next_comm=lab_stopper" in text or "lab_" in text))
    for text in texts:
        assert parts_of(text, due=due, at=at, pid=pid, own=(pid,)).startswith(f"{kind.name} lab_stopper ")


THREADS = (ME, HOG, LOW, IDLE, OTHER)
LINES = st.one_of(
    st.builds(
        lambda before, after, state, cpu: lambda us: switch(us, before, after, state=state, cpu=cpu),
        st.sampled_from(THREADS), st.sampled_from(THREADS), st.sampled_from("RSD"), st.sampled_from((0, 1)),
    ),
    st.builds(
        lambda pid, by, flags, cpu: lambda us: waking(us, pid, by=by, flags=flags, cpu=cpu),
        st.sampled_from((1, 2, 3, 5)), st.sampled_from((0, 1, 2, 3, 5)),
        st.sampled_from(("d..2.", "d.h2.", "d.s2.")), st.sampled_from((0, 1)),
    ),
    st.builds(
        lambda text, cpu: lambda us: line(us, text, cpu=cpu),
        st.sampled_from(
            (
                "local_timer_entry: vector=236", "local_timer_exit: vector=236",
                "softirq_raise: vec=3 [action=NET_RX]", "softirq_entry: vec=3 [action=NET_RX]",
                "softirq_exit: vec=3 [action=NET_RX]",
                "hrtimer_start: hrtimer=a function=f expires=900000 softexpires=800000",
                "hrtimer_expire_entry: hrtimer=a function=f now=850000",
                "sched_migrate_task: comm=me pid=1 prio=4 orig_cpu=0 dest_cpu=1",
                "console: x", "cpu_frequency: state=0 cpu_id=0",
                "callback_end: took_ns=20000 name=a", "callback_begin: name=b",
                "cpu_frequency: state=1200000 cpu_id=0", "cpu_frequency: state=300000 cpu_id=1",
            )
        ),
        st.sampled_from((0, 1)),
    ),
)  # fmt: skip


@given(st.lists(st.tuples(st.integers(0, 3), LINES), max_size=60), st.integers(0, 100), st.integers(1, 100))
def test_parts_add_up_whatever_the_trace_says(steps, due, length):
    us, text = 0, ""
    for step, event in steps:
        us += step
        text += event(us)
    order = reconstruct(events(text))
    callbacks = order.callbacks.get(9, ())
    ends = {"due_ns": due * 1000, "at_ns": (due + length) * 1000}
    parts = cut(order, pid=1, own=frozenset({1, 5}), callbacks=callbacks, **ends)
    assert [part.begin_ns for part in parts[1:]] == [part.end_ns for part in parts[:-1]]
    assert (parts[0].begin_ns, parts[-1].end_ns) == (due * 1000, (due + length) * 1000)
    assert all(part.length_ns > 0 for part in parts)


@pytest.mark.parametrize("kind", list(Kind))
def test_every_kind_has_words_of_its_own(kind):
    assert kind.value
    assert len({kind.value for kind in Kind}) == len(Kind)
