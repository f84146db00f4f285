"""The cut of a late value: each kind of cause from a trace of a few lines, and sums that are exact for any trace."""

from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st
from traced import SPECIMENS, events, line, switch, waking

from rtrun.causes.cut import cut
from rtrun.causes.parts import Kind
from rtrun.causes.reconstruction import reconstruct

ME, HOG, LOW, IDLE, OTHER = ("me", 1, 4), ("hog", 2, 1), ("low", 3, 120), ("idle", 0, 120), ("mate", 5, 4)
# The timer of a thread was due at 1000 us, and the clock of the trace is 500 us ahead of the timers' clock.
START = line(100, "hrtimer_start: hrtimer=a function=hrtimer_wakeup expires=500000 softexpires=500000")


def expiry(us, late_us=0):
    """The interrupt of the timer, which begins at a moment, and wakes the thread 2 us later."""
    now = f"hrtimer_expire_entry: hrtimer=a function=hrtimer_wakeup now={500_000 + 1000 * late_us}"
    return (
        line(us, "local_timer_entry: vector=236")
        + line(us, now, flags="d.h..")
        + waking(us + 2, 1, flags="d.h..")
        + line(us + 3, "local_timer_exit: vector=236")
    )


def parts_of(text, *, due=1000, at, pid=1, own=(1,)):
    """What the lines say, as (kind, name, microseconds); what has one cause and follows each other is one."""
    made = cut(reconstruct(events(text)), pid=pid, own=frozenset(own), due_ns=due * 1000, at_ns=at * 1000)
    assert sum(part.length_ns for part in made) == (at - due) * 1000
    return [
        (kind, name, sum(part.length_ns for part in alike) // 1000)
        for (kind, name, _), alike in groupby(made, key=lambda part: (part.cause.kind, part.cause.name, part.cpu))
    ]


BEFORE = START + switch(200, ME, LOW)


def test_a_thread_of_higher_priority():
    text = BEFORE + switch(990, LOW, HOG, state="R") + expiry(1000) + switch(1400, HOG, ME) + line(1410, "x: y")
    assert parts_of(text, at=1410) == [
        (Kind.INTERRUPT, "the timer's own", 2),
        (Kind.INTERRUPT, "local_timer", 1),
        (Kind.HIGHER, "hog", 397),
        (Kind.PROGRAM, "me", 10),
    ]


def timed_out(*, awaited_waits: bool) -> str:
    """The measured thread waits for its mate with a timeout, which comes 400 us after the value was due."""
    return (
        line(100, "hrtimer_start: hrtimer=a function=hrtimer_wakeup expires=900000 softexpires=900000")
        + waking(110, 1, by=5)
        + switch(120, OTHER, ME)
        + switch(200, ME, LOW)
        + switch(900, LOW, HOG, state="R")
        + (waking(995, 5, flags="d.h..") if awaited_waits else "")
        + expiry(1400, late_us=400)
        + ("" if awaited_waits else waking(1450, 5, flags="d.h.."))
        + switch(1500, HOG, OTHER)
        + switch(1510, OTHER, ME)
        + line(1520, "x: y")
    )


def test_a_timeout_is_not_what_was_waited_for():
    """The thread that should have handed work over waited for the CPU: it is followed."""
    parts = parts_of(timed_out(awaited_waits=True), at=1520, own=(1, 5))
    assert sum(length for kind, name, length in parts if (kind, name) == (Kind.HIGHER, "hog")) == 497
    assert Kind.OWN_SLEEP not in {kind for kind, _, _ in parts}


def test_a_timeout_before_there_was_work():
    parts = parts_of(timed_out(awaited_waits=False), at=1520, own=(1, 5))
    assert (Kind.OWN_SLEEP, "me", 400) in parts


def test_a_thread_of_the_same_priority():
    equal = ("equal", 4, 4)
    text = BEFORE + switch(990, LOW, equal, state="R") + expiry(1000) + switch(1400, equal, ME) + line(1410, "x: y")
    assert (Kind.EQUAL, "equal", 397) in parts_of(text, at=1410)


def test_a_thread_that_could_not_be_preempted():
    text = BEFORE + expiry(1000) + switch(1400, LOW, ME, state="R") + line(1410, "x: y")
    assert (Kind.NOT_PREEMPTED, "low", 397) in parts_of(text, at=1410)


@pytest.mark.parametrize("waits", [4, -1])
def test_a_thread_at_sched_deadline_has_no_priority_to_be_lowered(waits):
    """Two of them are no threads of one priority either."""
    me, control = ("me", 1, waits), ("control", 2, -1)
    text = START + switch(200, me, LOW) + switch(990, LOW, control, state="R") + expiry(1000)
    text += switch(1400, control, me) + line(1410, "x: y")
    assert (Kind.DEADLINE, "control", 397) in parts_of(text, at=1410)


def test_threads_without_a_real_time_policy_share_the_cpu():
    """Nobody throttles: the scheduler chose one with a lower weight."""
    me, nice = ("me", 1, 120), ("nice", 7, 130)
    text = START + switch(200, me, LOW) + expiry(1000) + switch(1010, LOW, me, state="R")
    text += switch(1020, me, nice, state="R") + switch(1400, nice, me, state="R") + line(1410, "x: y")
    assert (Kind.SHARED, "nice", 380) in parts_of(text, at=1410)


def test_throttling():
    """A thread of lower priority was chosen although the measured one could run."""
    text = BEFORE + switch(990, LOW, HOG, state="R") + expiry(1000)
    text += switch(1100, HOG, LOW, state="R") + switch(1400, LOW, ME, state="R") + line(1410, "x: y")
    assert parts_of(text, at=1410)[2:] == [
        (Kind.HIGHER, "hog", 97),
        (Kind.THROTTLED, "low", 300),
        (Kind.PROGRAM, "me", 10),
    ]


def test_throttling_that_began_before():
    """When the thread woke up, one of lower priority had been chosen in place of another real-time thread."""
    below, other = ("below", 7, 49), ("other", 8, 120)
    text = (
        START + switch(200, ME, below) + switch(900, below, other, state="R") + switch(950, other, LOW) + expiry(1000)
    )
    assert (Kind.THROTTLED, "low", 397) in parts_of(
        text + switch(1400, LOW, ME, state="R") + line(1410, "x: y"), at=1410
    )


def woken_on_an_idle_cpu(before_idle=""):
    """Real-time threads are throttled; then the CPU goes idle, and the measured thread wakes up there."""
    below = ("below", 7, 49)
    text = START + switch(200, ME, below) + switch(900, below, LOW, state="R") + before_idle + switch(960, LOW, IDLE)
    text += expiry(1000) + switch(1400, IDLE, ME, state="R") + line(1410, "x: y")
    return parts_of(text, at=1410)


def test_throttling_of_a_cpu_that_is_left_idle():
    """No thread but real-time ones could go on: the CPU is idle until they may."""
    assert (Kind.THROTTLED, "idle", 397) in woken_on_an_idle_cpu()


def test_a_thread_that_went_to_another_cpu_was_not_passed_over():
    moved = line(950, "sched_migrate_task: comm=below pid=7 prio=49 orig_cpu=0 dest_cpu=1")
    assert (Kind.IDLE_EXIT, "", 397) in woken_on_an_idle_cpu(moved)
    runs = line(940, "x: y", cpu=1) + switch(950, OTHER, ("below", 7, 49), cpu=1)
    assert (Kind.IDLE_EXIT, "", 397) in woken_on_an_idle_cpu(runs), "nor one that already runs there"
    lost = "CPU:0 [LOST 5 EVENTS]\n"
    assert (Kind.IDLE_EXIT, "", 397) in woken_on_an_idle_cpu(lost), "nor one that may have gone among lost events"


def woken_before_a_switch(event):
    """The measured thread was woken on a CPU that then goes from a thread without real-time priority to idle."""
    text = BEFORE + expiry(1000) + line(1004, f"{event}: comm=me pid=1 prio=4 target_cpu=000", flags="d.h..")
    return parts_of(text + switch(1050, LOW, IDLE) + switch(1400, IDLE, ME, state="R") + line(1410, "x: y"), at=1410)


def test_throttling_when_the_cpu_goes_idle_although_the_thread_is_on_its_queue():
    assert (Kind.THROTTLED, "idle", 350) in woken_before_a_switch("sched_wakeup")


def test_a_thread_that_is_not_yet_on_the_queue_was_not_passed_over():
    assert (Kind.IDLE_EXIT, "", 350) in woken_before_a_switch("sched_stat_x")


def test_interrupts_off():
    text = BEFORE + expiry(1300, late_us=300) + switch(1304, LOW, ME, state="R") + line(1310, "x: y")
    assert parts_of(text, at=1310)[:2] == [(Kind.TIMER_LATE, "low", 300), (Kind.INTERRUPT, "the timer's own", 2)]


def mate_without_interrupts(timer_started_us=900):
    """A thread of the program has the CPU; another timer of that CPU was due at 1050 us, and its interrupt is late."""
    tick = "hrtimer_start: hrtimer=b function=tick_sched_timer expires=550000 softexpires=550000"
    text = START + switch(200, ME, OTHER) + expiry(1000)
    text += line(timer_started_us, tick) + line(1350, "local_timer_entry: vector=236")
    text += line(1350, "hrtimer_expire_entry: hrtimer=b function=tick_sched_timer now=850000", flags="d.h..")
    text += line(1352, "local_timer_exit: vector=236") + switch(1400, OTHER, ME) + line(1410, "x: y")
    return parts_of("".join(sorted(text.splitlines(keepends=True), key=lambda one: one[35:47])), at=1410, own=(1, 5))


def test_a_thread_of_the_program_while_no_interrupt_came():
    """Interrupts were off, or the CPU was not run: the thread may be innocent."""
    assert mate_without_interrupts()[2:] == [
        (Kind.OTHER_THREAD, "mate", 47),
        (Kind.TIMER_LATE, "mate", 300),
        (Kind.INTERRUPT, "local_timer", 2),
        (Kind.OTHER_THREAD, "mate", 48),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_timer_that_was_started_too_late_did_not_wait_for_interrupts():
    assert mate_without_interrupts(timer_started_us=1300)[2:5] == [
        (Kind.OTHER_THREAD, "mate", 297),
        (Kind.TIMER_LATE, "mate", 50),
        (Kind.INTERRUPT, "local_timer", 2),
    ]


def test_an_idle_state():
    text = START + switch(200, ME, IDLE) + expiry(1300, late_us=300) + switch(1350, IDLE, ME, state="R")
    assert parts_of(text + line(1360, "x: y"), at=1360) == [
        (Kind.TIMER_LATE, "idle", 300),
        (Kind.INTERRUPT, "the timer's own", 2),
        (Kind.INTERRUPT, "local_timer", 1),
        (Kind.IDLE_EXIT, "", 47),
        (Kind.PROGRAM, "me", 10),
    ]


def test_an_interrupt_and_a_softirq_before_the_thread_runs():
    text = (
        BEFORE + line(950, "irq_handler_entry: irq=53 name=eth0") + line(1200, "irq_handler_exit: irq=53 ret=handled")
    )
    text += expiry(1200, late_us=200) + line(1203, "softirq_entry: vec=3 [action=NET_RX]", flags="..s..")
    text += line(1300, "softirq_exit: vec=3 [action=NET_RX]", flags="..s..") + switch(1301, LOW, ME, state="R")
    assert parts_of(text + line(1310, "x: y"), at=1310) == [
        (Kind.INTERRUPT, "53 eth0", 200),
        (Kind.INTERRUPT, "the timer's own", 2),
        (Kind.INTERRUPT, "local_timer", 1),
        (Kind.SOFTIRQ, "NET_RX", 97),
        (Kind.NOT_PREEMPTED, "low", 1),
        (Kind.PROGRAM, "me", 9),
    ]


def test_timer_slack():
    start = line(100, "hrtimer_start: hrtimer=a function=hrtimer_wakeup expires=550000 softexpires=500000")
    text = start + switch(200, ME, LOW) + expiry(1050, late_us=50) + switch(1060, LOW, ME, state="R")
    assert parts_of(text + line(1070, "x: y"), at=1070)[0] == (Kind.TIMER_SLACK, "", 50)


def test_a_lock_held_by_another_thread():
    """The system call futex with FUTEX_WAIT says that it was a lock."""
    text = BEFORE + expiry(1000) + switch(1005, LOW, ME, state="R")
    text += line(1010, "sys_futex(uaddr: 0x7f, op: 0x80, val: 2, utime: 0)", name="me", pid=1)
    text += switch(1011, ME, LOW) + waking(1400, 1, by=3) + switch(1402, LOW, ME, state="R") + line(1410, "x: y")
    assert parts_of(text, at=1410)[3:] == [
        (Kind.PROGRAM, "me", 6),
        (Kind.LOCK, "low", 389),
        (Kind.NOT_PREEMPTED, "low", 2),
        (Kind.PROGRAM, "me", 8),
    ]


# Of real traces: when the value was due, when the thread ran again, the thread, and what was done to it.
HELD = {
    "stopped.txt": (6629_084355, 6629_107280, 15232, Kind.STOPPED),
    "frozen-v1.txt": (6631_720061, 6631_761390, 15560, Kind.FROZEN),
    "frozen-v2.txt": (6634_134046, 6634_169140, 16029, Kind.FROZEN),
}


@pytest.mark.parametrize("name", HELD)
def test_a_program_that_is_stopped_or_frozen(name):
    """Whoever did it is named, and not followed to what it did before."""
    due, at, pid, kind = HELD[name]
    assert parts_of((SPECIMENS / name).read_text(), due=due, at=at, pid=pid, own=(pid,))[0][:2] == (kind, "lab_stopper")


@pytest.mark.parametrize("name", ["stopped.txt", "frozen-v2.txt"])
def test_a_program_that_is_let_go_on_by_whom_the_trace_still_shows(name):
    """The buffer had overwritten what came before."""
    due, at, pid, kind = HELD[name]
    lines = (SPECIMENS / name).read_text().splitlines(keepends=True)
    begin = next(place for place, text in enumerate(lines) if "=lab_stopper" in text and place > len(lines) - 30)
    text = "".join(one for one in lines[begin:] if "next_comm=lab_stopper" in one or "lab_" in one)
    assert parts_of(text, due=due, at=at, pid=pid, own=(pid,))[0][:2] == (kind, "lab_stopper")


def test_who_stopped_a_program_is_named_rather_than_who_let_it_go_on():
    text = BEFORE + line(300, "signal_generate: sig=19 errno=0 code=0 comm=me pid=1 grp=1 res=0", name="low", pid=3)
    text += switch(310, LOW, ME) + switch(320, ME, LOW, state="T") + switch(330, LOW, HOG)
    text += waking(1400, 1, by=2) + switch(1402, HOG, ME, state="R") + line(1410, "x: y")
    assert parts_of(text, at=1410)[0] == (Kind.STOPPED, "low", 400)
    assert parts_of(text.replace("sig=19", "sig=10"), at=1410)[0] == (Kind.STOPPED, "hog", 400)


def test_a_thread_that_woke_another_in_time_did_not_freeze_it():
    """Its timer had not expired: the lock was given free before."""
    text = START.replace("=500000", "=900000") + switch(200, ME, LOW) + waking(1300, 1, by=3) + switch(1302, LOW, ME)
    assert Kind.FROZEN not in {kind for kind, _, _ in parts_of(text + line(1310, "x: y"), at=1310)}


def test_a_page_fault_that_waits_for_memory():
    text = BEFORE + expiry(1000) + switch(1005, LOW, ME, state="R")
    text += line(1010, "page_fault_user: address=0x7f ip=0x55 error_code=0x6", name="me", pid=1)
    text += switch(1011, ME, LOW, state="D") + waking(1400, 1, by=3) + switch(1402, LOW, ME, state="R")
    assert (Kind.FAULT, "low", 389) in parts_of(text + line(1410, "x: y"), at=1410)


def test_page_faults_while_it_runs():
    """Each is short, and they follow each other; the last one is too far away to be one of them."""
    text = BEFORE + expiry(1000) + switch(1005, LOW, ME, state="R")
    fault = "page_fault_user: address=0x7f ip=0x55 error_code=0x6"
    text += "".join(line(us, fault, name="me", pid=1) for us in (1010, 1030, 1050, 1090, 1200)) + line(1210, "x: y")
    assert parts_of(text, at=1210)[3:] == [
        (Kind.PROGRAM, "me", 5),
        (Kind.FAULT, "me", 80),
        (Kind.PROGRAM, "me", 120),
    ]


def test_a_thread_of_the_middleware_is_followed():
    """The timer wakes a thread of the program, which wakes the measured one for the callback."""
    text = START + switch(200, OTHER, LOW) + switch(300, LOW, ME, state="R") + switch(310, ME, LOW)
    text += expiry(1000).replace("pid=1 ", "pid=5 ") + switch(1200, LOW, OTHER, state="R")
    text += waking(1250, 1, by=5) + switch(1260, OTHER, ME) + line(1270, "x: y")
    assert parts_of(text, at=1270, own=(1, 5)) == [
        (Kind.INTERRUPT, "the timer's own", 2),
        (Kind.INTERRUPT, "local_timer", 1),
        (Kind.NOT_PREEMPTED, "low", 197),
        (Kind.OTHER_THREAD, "mate", 60),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_message_is_followed_to_its_sender():
    """The softirq of the loopback device runs in the sender, which had to wait for another thread."""
    sender = ("sender", 6, 120)
    text = switch(100, ME, IDLE, cpu=1) + switch(900, sender, HOG, state="R") + switch(1300, HOG, sender)
    text += line(1310, "softirq_raise: vec=3 [action=NET_RX]", name="sender", pid=6)
    text += line(1311, "softirq_entry: vec=3 [action=NET_RX]", name="sender", pid=6, flags="..s..")
    text += waking(1320, 1, by=6, target=1, flags="..s..")
    text += line(1321, "softirq_exit: vec=3 [action=NET_RX]", name="sender", pid=6, flags="..s..")
    text += switch(1350, IDLE, ME, state="R", cpu=1) + line(1360, "x: y", cpu=1) + line(1360, "x: y")
    assert parts_of(text, at=1360) == [
        (Kind.HIGHER, "hog", 300),
        (Kind.OTHER_THREAD, "sender", 11),
        (Kind.SOFTIRQ, "NET_RX", 9),
        (Kind.IDLE_EXIT, "", 30),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_migration_while_it_waits():
    """It waits for the hog on CPU 0, then for an idle CPU 1 to wake up."""
    text = line(50, "x: y", cpu=1, name="idle", pid=0) + BEFORE + switch(990, LOW, HOG, state="R") + expiry(1000)
    text += line(1100, "sched_migrate_task: comm=me pid=1 prio=4 orig_cpu=0 dest_cpu=1", name="hog", pid=2)
    text += switch(1150, IDLE, ME, state="R", cpu=1) + line(1160, "x: y", cpu=1)
    assert parts_of(text, at=1160)[2:] == [
        (Kind.HIGHER, "hog", 97),
        (Kind.IDLE_EXIT, "", 50),
        (Kind.PROGRAM, "me", 10),
    ]


def test_lost_events_are_unexplained():
    text = BEFORE + switch(990, LOW, HOG, state="R") + expiry(1000) + "CPU:0 [LOST 5 EVENTS]\n"
    text += switch(1400, HOG, ME) + line(1410, "x: y")
    assert (Kind.UNEXPLAINED, "events are missing", 397) in parts_of(text, at=1410)


def test_a_trace_that_begins_too_late():
    assert parts_of(switch(1400, HOG, ME) + line(1410, "x: y"), at=1410) == [
        (Kind.UNEXPLAINED, "", 400),
        (Kind.PROGRAM, "me", 10),
    ]


def woken_before(cpu_1_begins_us, between=""):
    """Nobody is seen to wake the measured thread, which waits for the CPU when the trace begins."""
    text = line(1100, "x: y", name="hog", pid=2) + line(cpu_1_begins_us, "x: y", cpu=1, name="idle", pid=0) + between
    return parts_of(text + switch(1400, HOG, ME) + line(1410, "x: y"), at=1410)


def test_a_thread_that_was_woken_before_the_trace_begins():
    """It waited from when every CPU is in the trace: before that, one that is not may have woken it."""
    for begins_us, length in ((1090, 300), (1200, 200)):
        assert woken_before(begins_us) == [
            (Kind.UNEXPLAINED, "", 400 - length),
            (Kind.HIGHER, "hog", length),
            (Kind.PROGRAM, "me", 10),
        ]


def test_a_softirq_that_began_before_the_trace_is_known_by_its_end():
    """Also where another thread, as with PREEMPT_RT, or an interrupt ran within it; not in other threads."""
    other = ("other", 8, 0)
    text = line(900, "x: y", name="hog", pid=2) + waking(990, 1, flags="d.h..")
    text += switch(1100, HOG, other, state="R") + switch(1150, other, HOG)
    text += line(1200, "irq_handler_entry: irq=53 name=eth0") + line(1210, "irq_handler_exit: irq=53 ret=handled")
    text += line(1300, "softirq_exit: vec=3 [action=NET_RX]", name="hog", pid=2, flags="..s..")
    text += switch(1400, HOG, ME) + line(1410, "x: y")
    assert parts_of(text, at=1410) == [
        (Kind.SOFTIRQ, "NET_RX", 100),
        (Kind.HIGHER, "other", 50),
        (Kind.SOFTIRQ, "NET_RX", 50),
        (Kind.INTERRUPT, "53 eth0", 10),
        (Kind.SOFTIRQ, "NET_RX", 90),
        (Kind.HIGHER, "hog", 100),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_softirq_that_began_among_lost_events_is_known_by_its_end():
    text = BEFORE + waking(990, 1, flags="d.h..") + line(1000, "x: y") + "CPU:0 [LOST 5 EVENTS]\n"
    text += line(1100, "x: y", name="other", pid=8) + switch(1150, ("other", 8, 0), HOG)
    text += line(1300, "softirq_exit: vec=3 [action=NET_RX]", name="hog", pid=2, flags="..s..")
    assert parts_of(text + switch(1400, HOG, ME) + line(1410, "x: y"), at=1410)[-4:] == [
        (Kind.UNEXPLAINED, "events are missing", 150),
        (Kind.SOFTIRQ, "NET_RX", 150),
        (Kind.HIGHER, "hog", 100),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_wake_up_may_be_among_lost_events():
    assert woken_before(1090, "CPU:1 [LOST 5 EVENTS]\n" + line(1250, "x: y", cpu=1, name="idle", pid=0)) == [
        (Kind.UNEXPLAINED, "", 250),
        (Kind.HIGHER, "hog", 150),
        (Kind.PROGRAM, "me", 10),
    ]


def test_a_new_thread_did_not_wait_since_the_trace_began():
    new = waking(1150, 5, cpu=1) + line(
        1300, "sched_wakeup_new: comm=me pid=1 prio=4 target_cpu=000", cpu=1, name="idle", pid=0
    )
    assert woken_before(1090, new)[-2:] == [(Kind.HIGHER, "hog", 100), (Kind.PROGRAM, "me", 10)]


def test_a_thread_that_is_not_in_the_trace():
    assert parts_of(switch(1400, HOG, LOW), at=1410, pid=77) == [(Kind.UNEXPLAINED, "", 410)]


PRINTED = line(980, "console: [    1.0] Mem-Info", name="low", pid=3)


def test_printk_to_a_console_with_interrupts_off():
    """The line is in the ring before the thread writes it to the console."""
    text = BEFORE + PRINTED + expiry(1300, late_us=300) + switch(1304, LOW, ME, state="R") + line(1310, "x: y")
    assert parts_of(text, at=1310)[0] == (Kind.CONSOLE, "low", 300)


def test_printk_to_a_console_with_preemption_off():
    text = BEFORE + PRINTED + expiry(1000) + switch(1400, LOW, ME, state="R") + line(1410, "x: y")
    assert (Kind.CONSOLE, "low", 397) in parts_of(text, at=1410)


def test_what_a_thread_printed_before_it_slept_is_not_to_blame():
    text = START + switch(150, ME, LOW) + line(160, "console: [    1.0] x", name="low", pid=3)
    text += switch(170, LOW, IDLE) + switch(180, IDLE, LOW) + expiry(1000) + switch(1400, LOW, ME, state="R")
    assert (Kind.NOT_PREEMPTED, "low", 397) in parts_of(text + line(1410, "x: y"), at=1410)


def test_stop_machine():
    """The thread that stops the CPU has a priority above every other: to blame with interrupts off as well as on."""
    stopper = ("migration/0", 6, 0)
    text = BEFORE + switch(990, LOW, stopper, state="R") + expiry(1300, late_us=300) + switch(1400, stopper, ME)
    assert parts_of(text + line(1410, "x: y"), at=1410) == [
        (Kind.HIGHER, "migration/0", 300),
        (Kind.INTERRUPT, "the timer's own", 2),
        (Kind.INTERRUPT, "local_timer", 1),
        (Kind.HIGHER, "migration/0", 97),
        (Kind.PROGRAM, "me", 10),
    ]


def frequency(us, khz, cpu=0):
    # Another CPU may say so.
    return line(us, f"cpu_frequency: state={khz} cpu_id={cpu}", cpu=1, name="sugov:0", pid=7)


def test_a_governor_that_reduces_the_frequency():
    """At a quarter of it the thread takes four times as long; what it waits for takes no longer."""
    text = frequency(50, 1_200_000) + BEFORE + expiry(1000) + switch(1010, LOW, ME, state="R")
    text += frequency(1110, 300_000) + line(1510, "x: y")
    assert parts_of(text, at=1510)[3:] == [(Kind.PROGRAM, "me", 200), (Kind.SLOWED, "below 1200 MHz", 300)]
    other_cpu = text.replace("cpu_id=0", "cpu_id=1")
    assert parts_of(other_cpu, at=1510)[3:] == [(Kind.PROGRAM, "me", 500)]


def test_the_frequency_rises_while_a_thread_runs():
    text = frequency(50, 600_000) + BEFORE + expiry(1000) + switch(1010, LOW, ME, state="R")
    text += frequency(1110, 1_200_000) + line(1210, "x: y")
    assert parts_of(text, at=1210)[3:] == [
        (Kind.PROGRAM, "me", 50),
        (Kind.SLOWED, "below 1200 MHz", 50),
        (Kind.PROGRAM, "me", 100),
    ]


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
                "cpu_frequency: state=1200000 cpu_id=0", "cpu_frequency: state=300000 cpu_id=1",
            )
        ),
        st.sampled_from((0, 1)),
    ),
)  # fmt: skip


@given(st.lists(st.tuples(st.integers(0, 3), LINES), max_size=60), st.integers(0, 100), st.integers(1, 100))
def test_parts_add_up_whatever_the_trace_says(steps, due, length):
    us, text = 0, ""
    for step, made in steps:
        us += step
        text += made(us)
    made = cut(reconstruct(events(text)), pid=1, own=frozenset({1, 5}), due_ns=due * 1000, at_ns=(due + length) * 1000)
    assert [part.begin_ns for part in made[1:]] == [part.end_ns for part in made[:-1]]
    assert (made[0].begin_ns, made[-1].end_ns) == (due * 1000, (due + length) * 1000)
    assert all(part.length_ns > 0 for part in made)


@pytest.mark.parametrize("kind", list(Kind))
def test_every_kind_has_words_of_its_own(kind):
    assert kind.value
    assert len({one.value for one in Kind}) == len(Kind)
