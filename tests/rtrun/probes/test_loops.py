"""Loops that no timer of ROS drives, observed without probes, against what their programs print about themselves."""

import contextlib
import os
import shutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from probes.standin import SCRIPTS, TRACING, left, running, scripts_of_busybox, wait_until_nothing_is_left

from rtfiles.output import printable
from rtrun.execution import observation
from rtrun.execution.board import utc_now
from rtrun.flows.streams import streams
from rtrun.kinds.loop import STREAM as LOOP
from rtrun.kinds.loop_response import STREAM as RESPONSE
from rtrun.plan.observation import ObservationPlan, read_stream_deadline
from rtrun.probes import loops, session
from rtrun.probes.hits import GapCause
from rtrun.probes.loops import LoopWatch
from rtrun.probes.placement import Placement
from rtrun.probes.programs import find_programs
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import kernel_trace

pytestmark = [pytest.mark.trace, pytest.mark.timeout(180)]
MS = 10**6
ASYNCIO = """
    import asyncio, time
    async def beat():
        due = asyncio.get_running_loop().time()
        while True:
            due += 0.005
            await asyncio.sleep(due - asyncio.get_running_loop().time())
            print(0, time.monotonic_ns(), 0, flush=True)
    asyncio.run(beat())
"""
RUNNER = """
    import sys
    from pathlib import PurePosixPath
    from probes.standin import SCRIPTS
    from rtrun.probes.loops import FUNCTIONS, LoopWatch
    from rtrun.probes.placement import Placement
    from rtrun.probes.session import observe
    from rtrun.targets.address import ThisMachine
    from rtrun.targets.config import Target
    from rtrun.targets.inspection.kernel_trace import read_symbols
    from rtrun.targets.link import Link
    target = Target(name="t", address=ThisMachine(), suites=None, work_dir=PurePosixPath("/x"), setup=None,
                    master_port=1, reconnect_s=0, boot_s=0, console=None, failure=lambda: None)
    with Link(target, print) as link:
        watch = LoopWatch(names=["loop"], functions=read_symbols(link, FUNCTIONS))
        for each in observe(link, SCRIPTS, Placement(probes=(), refused=()), (), for_s=600, loops=watch):
            sys.stdout.write(type(each).__name__ + "\\n")
            sys.stdout.flush()
"""


@pytest.fixture(scope="session")
def loop(tmp_path_factory):
    """The path of the program with loops."""
    program = tmp_path_factory.mktemp("loop") / "observed-loop"
    source = Path(__file__).with_name("loop.c")
    subprocess.run(["cc", "-O1", "-Wall", "-Werror", "-pthread", "-o", program, source], check=True)
    return program


def observe(link, *deadlines, for_s=4.0, on_second=lambda _: None, scripts=SCRIPTS):
    plan = ObservationPlan(for_s=for_s, deadlines=[*map(read_stream_deadline, deadlines)])
    watched = observation.watch(link, scripts, plan)
    onlooker = observation.Onlooker(on_second=on_second, is_attended=True)
    result = observation.observe(link, scripts, watched, plan, trace="", onlooker=onlooker, now=utc_now)
    assert result.finished is None or result.finished.is_clean
    return result


def streams_of(result, program, kind=LOOP):
    """The streams of a program, by the names of its threads."""
    found = [
        stream for stream in streams(result.flows) if stream.kind is kind and stream.identity["program"] == program
    ]
    return {stream.identity["thread"]: stream for stream in found}


def only(result, program, kind=LOOP):
    (stream,) = streams_of(result, program, kind).values()
    return stream


def printed(path):
    """What a program printed about its cycles: due, ran, done; int64 of shape (3, n)."""
    lines = path.read_text().rpartition("\n")[0].splitlines()
    return np.array([[*map(int, line.split())] for line in lines], np.int64).T


@contextlib.contextmanager
def running_loop(program, way, priority, out):
    argv = [program, way, str(10**7), *([str(priority)] if priority else [])]
    with out.open("w") as file, subprocess.Popen(argv, stdout=file) as process:
        try:
            # It has its policy before its first cycle.
            while not out.stat().st_size:
                assert process.poll() is None
                time.sleep(0.01)
            yield process
        finally:
            process.kill()


def unmatched(stream, ran):
    """How many rows have not exactly one cycle of the program between when they ran and when the next one ran."""
    running_ns = stream.columns["running_ns"]
    between = ran[(ran >= running_ns[0]) & (ran < running_ns[-1])]
    cycles = np.bincount(np.searchsorted(running_ns, between, side="right") - 1, minlength=running_ns.size - 1)
    return int(np.count_nonzero(cycles != 1))


@pytest.mark.parametrize(
    ("way", "priority"), [("absolute", 50), ("until", 50), ("timerfd", 50), ("realtime", 50), ("absolute", 0)]
)
def test_each_cycle_agrees_with_what_the_program_prints(here, loop, tmp_path, way, priority):
    out = tmp_path / "out"
    with running_loop(loop, way, priority, out):
        result = observe(here, "loop:observed-loop=200us")
    due, ran, _ = printed(out)
    stream, response = only(result, "observed-loop"), only(result, "observed-loop", RESPONSE)
    rows, unseen = stream.columns["due_ns"].size, stream.source.unseen
    assert rows > 1000 and not result.flows.gaps
    # How many switches the kernel does not record depends on what else runs.
    assert unmatched(stream, ran) <= 2 * unseen
    if way in ("absolute", "timerfd"):
        # The kernel was asked for exactly the program's own times, and none is missing. Of several times that have
        # passed, the program's timerfd names the last; it was due at the first.
        asked = due[:-1] + MS
        first, last = (np.flatnonzero(asked == stream.columns["due_ns"][at]) for at in (0, -1))
        assert np.array_equal(asked[first[0] : last[0] + 1], stream.columns["due_ns"])
    assert (stream.columns["running_ns"] >= stream.columns["due_ns"]).all()
    assert (stream.columns["interrupt_ns"] >= stream.columns["due_ns"]).mean() > 0.99
    assert stream.identity.get("clock") == ("system" if way == "realtime" else None)
    assert stream.source.period_ns() == pytest.approx(MS, rel=0.01)
    # A response has begun when the thread was due, and ended when it had printed its line.
    begin, end, run = (response.columns[name] for name in RESPONSE.columns)
    assert np.isin(begin, stream.columns["due_ns"]).all() and abs(begin.size - rows) <= 1
    assert (
        (end > begin).all() and np.count_nonzero(run == 0) <= unseen + rows / 20 and (run <= end - begin).mean() > 0.99
    )


def test_cyclictest_agrees_cycle_by_cycle(here, tmp_path):
    """It prints how late each of its cycles was, in whole microseconds, by a look at the clock after the switch."""
    program, out = tmp_path / "cyclictest-of-test", tmp_path / "out"
    shutil.copy(shutil.which("cyclictest") or pytest.skip("no cyclictest here"), program)
    with out.open("w") as file, subprocess.Popen([program, "-v", "-t1", "-p70", "-i1000"], stdout=file) as process:
        try:
            while out.stat().st_size < 1000:
                assert process.poll() is None
                time.sleep(0.01)
            result = observe(here, "loop:cyclictest-of-test=200us")
        finally:
            process.terminate()
    lines = [line.split(":") for line in out.read_text().splitlines()]
    own_us = np.array([int(words[2]) for words in lines if len(words) == 3 and words[0].strip() == "0"])
    stream = only(result, program.name)
    late_us = (stream.columns["running_ns"] - stream.columns["due_ns"]) / 1000
    # Which of its cycles is the first row is not known: the one by which most of the others agree.
    starts = range(own_us.size - late_us.size + 1)
    share = [np.mean(np.abs(own_us[at : at + late_us.size] - late_us) <= 15) for at in starts]
    best = int(np.argmax(share))
    print(f"{late_us.size} cycles, {share[best]:.2%} within 15 us, {stream.source.unseen} begins not recorded")
    # By a wrong start they agree by chance alone. A busy machine has cycles whose clock was read later.
    assert late_us.size > 1000 and share[best] > 0.9
    after = own_us[best : best + late_us.size] + 1 > late_us
    assert np.count_nonzero(~after) <= stream.source.unseen


def test_what_a_loop_skips_and_what_it_asks_for_too_late(here, loop, tmp_path):
    """Each 50th cycle takes 2.5 periods. The times that have passed then are activations all the same."""
    out = tmp_path / "out"
    with running_loop(loop, "long", 50, out):
        result = observe(here, "loop:observed-loop=200us", "loop-response:observed-loop=2ms")
    _, ran, _ = printed(out)
    stream, response = only(result, "observed-loop"), only(result, "observed-loop", RESPONSE)
    assert unmatched(stream, ran) <= 2 * stream.source.unseen
    assert np.diff(stream.columns["due_ns"]).max() == MS and not stream.columns["skipped"].any()
    cycles = stream.columns["due_ns"].size / 50
    took = response.columns["end_ns"] - response.columns["begin_ns"]
    assert np.count_nonzero(took > 2.4 * MS) >= cycles - 1
    assert cycles - 1 <= stream.source.past_due
    assert any("the time had already passed" in text for text in stream.remarks)


def test_what_a_cycle_waits_for_is_part_of_its_response(here, loop, tmp_path):
    """A thread that waits for a lock sleeps as well, but its cycle has not ended."""
    out = tmp_path / "out"
    with running_loop(loop, "lock", 50, out):
        result = observe(here, "loop:observed-loop/observed-loop=200us")
    # The thread that holds the lock has the next number: it began later.
    response = streams_of(result, "observed-loop", RESPONSE)["observed-loop"]
    took = response.columns["end_ns"] - response.columns["begin_ns"]
    assert np.count_nonzero(took < 0.3 * MS) <= took.size / 20


def test_a_thread_that_never_sleeps_has_no_loop(here, loop, tmp_path):
    """It is not real-time: on a machine with few CPUs nothing else would run."""
    out = tmp_path / "out"
    with running_loop(loop, "busy", 0, out):
        result = observe(here, "loop:observed-loop=200us", for_s=2)
    stream = only(result, "observed-loop")
    assert not stream.columns["due_ns"].size
    assert "no loop: the thread never slept: it waits busily, or does not wait at all" in stream.remarks


def test_above_the_limit_events_rest(here, loop, tmp_path, monkeypatch):
    """The limit of loops comes on top of that of probes, while there is a loop."""
    monkeypatch.setattr(loops, "EVENTS_PER_S", 1000)
    monkeypatch.setattr(session, "LIMIT_PER_S", 1000)
    out = tmp_path / "out"
    with running_loop(loop, "absolute", 50, out):
        result = observe(here, "loop:observed-loop=200us", for_s=12)
    assert {gap.cause for gap in result.flows.gaps} == {GapCause.RESTED} and result.finished.rests
    stream = only(result, "observed-loop")
    due, cuts = stream.columns["due_ns"], stream.cuts
    assert cuts.size and due.size and not stream.columns["skipped"][cuts].any()
    inside = [gap.from_ns < at < gap.until_ns for gap in result.flows.gaps for at in stream.columns["running_ns"]]
    # The first events after a rest may come before the end of its gap is known.
    assert sum(inside) <= due.size / 20


def test_threads_that_come_later_and_go(here, loop, tmp_path):
    """The program that is named begins while it is observed, ends, and begins anew: its loop is the same."""
    begun, rows = [], []

    def on_second(snapshot):
        numbers = [row.n for row in snapshot.rows if (row.kind, row.name) == (LOOP, "observed-loop")]
        rows.append(max(numbers, default=0))
        if not begun or (len(begun) == 1 and rows[-1] > 1000):
            for process in begun:
                process.kill()
                process.wait()
            begun.append(subprocess.Popen([loop, "absolute", "100000", "50"], stdout=subprocess.DEVNULL))
        elif len(begun) == 2 and rows[-1] > 3000:
            raise KeyboardInterrupt

    try:
        result = observe(here, "loop:observed-loop=200us", for_s=100, on_second=on_second)
    finally:
        for process in begun:
            process.kill()
            process.wait()
    stream = only(result, "observed-loop")
    assert len(begun) == 2 and stream.identity["thread"] == "observed-loop"
    assert stream.cuts.size == 1 and not stream.columns["skipped"][stream.cuts[0]]


def test_a_program_of_several_threads(here, tmp_path):
    """Its real-time threads have the deadline, in the order of their numbers; its first thread is an ordinary one."""
    program = tmp_path / "four"
    shutil.copy(shutil.which("cyclictest") or pytest.skip("no cyclictest here"), program)
    with running(program, "-q", "-t3", "-p70", "-i2000") as process:
        while len([*Path(f"/proc/{process.pid}/task").iterdir()]) < 4:
            time.sleep(0.01)
        result = observe(here, "loop:four=200us", for_s=3)
        name = Path(f"/proc/{process.pid}/comm").read_text().strip()
    assert [*streams_of(result, "four")] == [name, f"{name}#2", f"{name}#3"]
    by_tid = {
        loop_thread.log.thread: tid
        for tid, loop_thread in result.flows.loops.threads.items()
        if loop_thread.log.program == "four"
    }
    tids = [by_tid[thread] for thread in streams_of(result, "four")]
    assert tids == sorted(tids)
    # The later ones have longer periods.
    periods = [stream.source.period_ns() for stream in streams_of(result, "four").values()]
    assert periods == [2 * MS, 2.5 * MS, 3 * MS]


@pytest.mark.parametrize("name", ["x) S 1 1 (y", "two\nlines", "a b", "ü#7", "-v", "%s$(id)`id`"])
def test_names_of_any_bytes(here, loop, tmp_path, name):
    program, out = tmp_path / name, tmp_path / "out"
    shutil.copy(loop, program)
    with running_loop(program, "absolute", 50, out):
        result = observe(here, "loop:nobody=1ms", for_s=3)
        seen = {stream.identity["program"]: stream for stream in streams(result.flows) if stream.kind is LOOP}
        if name.isprintable():
            named = find_programs(here, SCRIPTS, [name]).found
            assert name in {observable.program.file_name for observable in named}
    assert seen[printable(name)].columns["due_ns"].size > 500


@pytest.mark.parametrize(
    ("name", "priority"), [("loop:observed-loop=1ms", 0), ("loop:observed-loop/observed-loop=1ms", 50)]
)
def test_on_a_small_target(here, loop, tmp_path, name, priority):
    """Its shell and its tools are BusyBox's."""
    out = tmp_path / "out"
    with running_loop(loop, "absolute", priority, out):
        result = observe(here, name, for_s=3, scripts=scripts_of_busybox(tmp_path))
    stream = only(result, "observed-loop")
    assert stream.columns["due_ns"].size > 500 and unmatched(stream, printed(out)[1]) <= 2 * stream.source.unseen


def test_a_loop_of_asyncio_is_named_by_its_script(here, tmp_path):
    script, out = tmp_path / "beat.py", tmp_path / "out"
    script.write_text(textwrap.dedent(ASYNCIO))
    with out.open("w") as file, subprocess.Popen([sys.executable, script], stdout=file) as process:
        try:
            while not out.stat().st_size:
                time.sleep(0.01)
            result = observe(here, "loop:beat.py=20ms")
        finally:
            process.kill()
    stream = only(result, "beat.py")
    ran, running_ns = printed(out)[1], stream.columns["running_ns"]
    assert running_ns.size > 200
    # Where it is late, it goes on without a sleep. After each sleep it has at least one cycle.
    after = np.searchsorted(ran, running_ns)
    assert np.count_nonzero(np.diff(after) == 0) <= 2 * stream.source.unseen + running_ns.size / 20


def test_a_kernel_that_hides_its_addresses(here, monkeypatch):
    monkeypatch.setattr(kernel_trace, "read_symbols", lambda *_: {})
    plan = ObservationPlan(for_s=1, deadlines=[read_stream_deadline("loop:arm=1ms")])
    assert observation.watch(here, SCRIPTS, plan).loops is None
    nobody = observation.Watched(found=(), placement=Placement(probes=(), refused=()))
    with pytest.raises(TargetError, match=r"no loop is measured: the kernel hides the addresses .*kptr_restrict"):
        observation.observe(here, SCRIPTS, nobody, plan, trace="", onlooker=observation.NOBODY, now=utc_now)


def test_nothing_to_observe(here):
    plan = ObservationPlan(for_s=1)
    nobody = observation.Watched(
        found=(), placement=Placement(probes=(), refused=()), loops=LoopWatch(names=(), functions={})
    )
    with pytest.raises(TargetError, match="no program runs there that uses ROS, and no thread with a real-time policy"):
        observation.observe(here, SCRIPTS, nobody, plan, trace="", onlooker=observation.NOBODY, now=utc_now)


@pytest.mark.parametrize(
    "kills", [(1, 2, 5), pytest.param(range(30), marks=[pytest.mark.slow, pytest.mark.timeout(600)])]
)
def test_a_killed_runner_leaves_nothing(here, loop, tmp_path, kills):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with running_loop(loop, "absolute", 50, tmp_path / "out"):
        for number in kills:
            argv = [sys.executable, "-c", textwrap.dedent(RUNNER)]
            with subprocess.Popen(argv, env=environment, stdout=subprocess.PIPE) as runner:
                for _ in range(number % 6):
                    assert runner.stdout.readline()
                while not left():
                    assert runner.poll() is None
                    time.sleep(0.01)
                filters = [*TRACING.glob("instances/rtrun-observe-*/events/sched/sched_switch/filter")]
                assert filters
                runner.kill()
            wait_until_nothing_is_left()
