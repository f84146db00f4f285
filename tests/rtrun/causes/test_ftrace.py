"""The reader of the kernel's trace text."""

import tracemalloc

import pytest
from traced import events, head, line, specimen, switch

from rtfiles.errors import UsageError
from rtrun.causes import ftrace
from rtrun.causes.events import (
    Console,
    Context,
    Current,
    Fault,
    Frequency,
    Futex,
    Interrupt,
    Lost,
    Migration,
    Raise,
    Signal,
    Switch,
    Thaw,
    TimerExpiry,
    TimerStart,
    Wake,
)
from rtrun.causes.ftrace import parse, read_trace

A, B = ("a", 9, 4), ("b", 8, 120)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "sched_switch: prev_comm=a prev_pid=9 prev_prio=4 prev_state=R+ ==> "
            "next_comm=b c=d next_pid=8 next_prio=120",
            Switch(5000, 1, 9, "a", 4, "R+", 8, "b c=d", 120),
        ),
        (
            "sched_waking: comm=b pid=8 prio=120 target_cpu=003",
            Wake(5000, 1, 9, Context.THREAD, 8, 3, is_done=False),
        ),
        (
            "sched_wakeup: comm=b pid=8 prio=120 success=1 target_cpu=003",  # of Linux 3.4
            Wake(5000, 1, 9, Context.THREAD, 8, 3, is_done=True),
        ),
        ("sched_migrate_task: comm=b pid=8 prio=4 orig_cpu=1 dest_cpu=0", Migration(5000, 1, 8, 0)),
        ("irq_handler_entry: irq=53 name=eth0", Interrupt(5000, 1, Context.HARD, "53 eth0", begins=True)),
        ("irq_handler_exit: irq=53 ret=handled", Interrupt(5000, 1, Context.HARD, "", begins=False)),
        ("local_timer_entry: vector=236", Interrupt(5000, 1, Context.HARD, "local_timer", begins=True)),
        ("local_timer_exit: vector=236", Interrupt(5000, 1, Context.HARD, "local_timer", begins=False)),
        ("softirq_raise: vec=3 [action=NET_RX]", Raise(5000, 1, 9, Context.THREAD, "NET_RX")),
        ("softirq_entry: vec=3 [action=NET_RX]", Interrupt(5000, 1, Context.SOFT, "NET_RX", begins=True)),
        ("softirq_exit: vec=3 [action=NET_RX]", Interrupt(5000, 1, Context.SOFT, "NET_RX", begins=False)),
        (
            "hrtimer_start: hrtimer=0000000067ea50c6 function=hrtimer_wakeup expires=60 softexpires=10 mode=ABS",
            TimerStart(5000, 1, "0000000067ea50c6", 10, 60, 9),
        ),
        (
            "hrtimer_expire_entry: hrtimer=0000000067ea50c6 function=hrtimer_wakeup now=70",
            TimerExpiry(5000, 1, "0000000067ea50c6", 70, "hrtimer_wakeup"),
        ),
        ("sys_futex(uaddr: 0x7f, op: 0x81, val: 1, utime: 0)", Futex(5000, 1, 9, 0x81)),
        ("sys_futex(uaddr: 7f, op: 80, val: 1, utime: 0)", Futex(5000, 1, 9, 0x80)),
        ("sys_futex -> 0xfffffffffffffff5", Futex(5000, 1, 9, None)),
        ("page_fault_user: address=0x7f ip=0x55 error_code=0x6", Fault(5000, 1, 9)),
        ("console: [   12.3] text", Console(5000, 1, 9)),
        (
            "signal_generate: sig=19 errno=0 code=0 comm=a b pid=7 grp=1 res=0",
            Signal(5000, 1, 9, 19, 7),
        ),
        ("cgroup_unfreeze: root=0 id=44 level=1 path=/x", Thaw(5000, 1, 9)),
        ("cpu_frequency: state=1200000 cpu_id=0", Frequency(5000, 1, 0, 1_200_000)),
    ],
)
def test_each_event(text, expected):
    assert events(line(5, text, cpu=1, name="a")) == [Current(5000, 1, 9, "a"), expected]


@pytest.mark.parametrize(
    "text",
    [
        "            bash-1977  [000] .... 17284.993652: sys_close(fd: 3)",  # four flags
        "            bash-1977  (   1977) [000] .....  17284.993652: sys_close(fd: 3)",  # option record-tgid
        "            bash-1977  (-------) [000] .....  17284.993652: sys_close(fd: 3)",
        "          <idle>-0     [000] 17284.993652123: sys_close(fd: 3)",  # option irq-info off, nanoseconds
        "   kworker/0:1-e-1977  [000] d...1.. 17284.993652: sys_close(fd: 3)",  # a name with a dash; PREEMPT_RT of 4.x
    ],
)
def test_heads_of_other_kernels(text):
    (current,) = events(text)
    assert (current.at_ns // 1000, current.cpu) == (17284_993652, 0)


@pytest.mark.parametrize(
    ("flags", "context"),
    [("d..2.", Context.THREAD), ("d.h..", Context.HARD), ("dNH2.", Context.HARD), ("..s1.", Context.SOFT)],
)
def test_context(flags, context):
    wake = events(line(5, "sched_waking: comm=b pid=8 prio=120 target_cpu=000", flags=flags))[1]
    assert isinstance(wake, Wake)
    assert wake.context is context


def test_lost_events_belong_to_the_next_line_of_their_cpu():
    text = line(1, "x: y") + "CPU:1 [LOST 12 EVENTS]\n" + line(2, "x: y") + line(3, "x: y", cpu=1)
    assert [event for event in events(text) if isinstance(event, Lost)] == [Lost(3000, 1, 12)]


def test_lost_events_that_the_kernel_did_not_count():
    text = line(1, "x: y") + "CPU:0 [LOST EVENTS]\n" + line(2, "x: y")
    assert [event for event in events(text) if isinstance(event, Lost)] == [Lost(2000, 0, None)]


@pytest.mark.parametrize(
    "text",
    [
        "sched_switch: prev_comm=a prev_pid=9",
        "sched_waking: ",
        "hrtimer_start: hrtimer=1 function=f expires=99999999999999999999 softexpires=1",
        "softirq_entry: vec=3",
        "sched_migrate_task: comm=b pid=8 prio=4 orig_cpu=1 dest_cpu=99999",
    ],
)
def test_an_event_cut_off_or_out_of_range_is_counted(text, tmp_path):
    path = tmp_path / "trace"
    path.write_text(line(1, text) + "no line of a trace\n\n# a comment\n" + line(2, "local_timer_entry: vector=1"))
    trace = read_trace(path, until_ns=10**9)
    assert trace.not_read == 2
    assert len(trace.events) == 2


def test_a_file_of_trace_cmd_is_refused_with_a_hint(tmp_path):
    path = tmp_path / "trace.dat"
    path.write_bytes(b"\x17\x08\x44tracing6\0\0\0\0\0")
    with pytest.raises(UsageError, match=r"trace.dat: a file of trace-cmd; .* cat /sys/kernel/tracing/trace"):
        read_trace(path, until_ns=0)


def test_lines_put_together_by_hand_are_sorted(tmp_path):
    path = tmp_path / "trace"
    path.write_text(switch(30, A, B, cpu=1) + switch(10, A, B) + switch(20, B, A))
    assert [event.at_ns for event in read_trace(path, until_ns=25_000).events] == [10_000, 10_000, 20_000]


def test_of_a_long_trace_the_last_events_before_the_moment_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(ftrace, "EVENTS_MAX", 10)
    path = tmp_path / "trace"
    path.write_text("".join(switch(us, A, B) + switch(us + 1, B, A) for us in range(0, 1000, 2)))
    times = [event.at_ns for event in read_trace(path, until_ns=500_000).events]
    assert times == [us * 1000 for us in range(491, 501)]


def lines_from(begin_us, number):
    """Lines of two CPUs, 10 us apart, each CPU with a timer that was started at the begin."""
    timers = [f"hrtimer_start: hrtimer=t{cpu} function=f expires=9 softexpires=9" for cpu in (0, 1)]
    text = [line(begin_us, timer, cpu=cpu) for cpu, timer in enumerate(timers)]
    return text + [switch(begin_us + 10 * place, A, B, cpu=place % 2) for place in range(1, number)]


def test_what_is_before_the_moment_is_passed_over_but_for_timers(tmp_path, monkeypatch):
    monkeypatch.setattr(ftrace, "PIECE_BYTES", 1000)
    path = tmp_path / "trace"
    path.write_text("".join(lines_from(0, 1000)))
    whole, late = (read_trace(path, from_ns=from_ns, until_ns=10**10) for from_ns in (0, 8_000_000))
    assert len(whole.events) > 1000 and whole.started == ()
    assert 200 <= len(late.events) < 230, "a piece has some lines more"
    assert late.events[3:] == whole.events[len(whole.events) - len(late.events) + 3 :], "but for who had the CPUs"
    assert {start.timer for start in late.started} == {"t0", "t1"}


def test_a_file_whose_times_go_back_is_read_whole(tmp_path, monkeypatch):
    """One CPU after the other, as of trace files of each CPU that were put together by hand."""
    monkeypatch.setattr(ftrace, "PIECE_BYTES", 1000)
    path = tmp_path / "trace"
    path.write_text("".join(lines_from(0, 500)) + "".join(lines_from(0, 500)))
    trace = read_trace(path, from_ns=4_000_000, until_ns=10**10)
    assert len(trace.events) == 2 * 501 + 2
    assert [event.at_ns for event in trace.events] == sorted(event.at_ns for event in trace.events)


def test_a_line_without_end_is_read_in_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(ftrace, "PIECE_BYTES", 1000)
    path = tmp_path / "trace"
    path.write_text("x" * 10_000 + "\n" + line(5, "local_timer_entry: vector=1"))
    trace = read_trace(path, until_ns=10**9)
    assert trace.not_read == 10 and len(trace.events) == 2


@pytest.mark.parametrize("from_ns", [0, 10**9])
def test_the_memory_does_not_grow_with_the_file(from_ns, tmp_path, monkeypatch):
    monkeypatch.setattr(ftrace, "EVENTS_MAX", 1000)
    peaks = []
    for times in (1, 4):
        path = tmp_path / f"trace{times}"
        path.write_text("".join(lines_from(0, 1500 * times)))
        tracemalloc.start()
        read_trace(path, from_ns=from_ns, until_ns=10**10)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0], peaks


@pytest.mark.parametrize("event", ["sched_switch", "sched_waking"])
def test_long_arguments_take_no_memory(event):
    lines = (line(us, f"{event}: {us}" + 20_000 * "x") for us in range(1000))
    tracemalloc.start()
    assert [parsed for parsed in parse(lines) if parsed is not None] == [Current(0, 0, 9, "x")]
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_a_real_trace_is_read_whole(tmp_path):
    parsed = list(parse((head(1, 1, 1) + specimen(1558)).split("\n")))
    assert None not in parsed
    assert len(parsed) > 500
