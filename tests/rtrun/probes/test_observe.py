"""Probes on programs that run: what they see, and that nothing of them is left, whatever happens."""

import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest
from probes import standin as standins
from probes.standin import EVENTS, SCRIPTS, TRACING, find, left, observed, running, tell, wait_until_nothing_is_left
from proxy import proxy_to

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.timer import STREAM as TIMER
from rtrun.probes.libraries.description import events
from rtrun.probes.placement import place
from rtrun.probes.programs import find_programs
from rtrun.probes.session import Batch, Began, Finished, observe
from rtrun.probes.stream import WatchReader
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

pytestmark = [pytest.mark.trace, pytest.mark.timeout(120)]
RUNNER = """
    import sys
    from pathlib import Path, PurePosixPath
    from probes.standin import observed
    from rtrun.targets.address import Address, ThisMachine
    from rtrun.targets.config import Target
    from rtrun.targets.link import Link
    address = {address!r}
    target = Target(name="t", address=address, suites=None, work_dir=PurePosixPath("/x"), setup=None, master_port=1,
                    reconnect_s=0, boot_s=0, console=None, failure=lambda: None)
    def say(text):  # print writes the end of a line apart, and two threads speak here
        sys.stdout.write(text + "\\n")
        sys.stdout.flush()
    with Link(target, say) as link:
        for each in observed(link, {pid}):
            say(type(each).__name__)
"""


@pytest.fixture(params=["local", "sshd"])
def link(request, loopback):
    """To this machine, in both ways."""
    if request.param == "local":
        yield request.getfixturevalue("here")
        return
    standins.skip_without_trace()
    with Link(loopback, print) as link:
        yield link


def values_of(results, event):
    return [hit for result in results if isinstance(result, Batch) for hit in result.hits if hit.event == event]


def test_every_message_is_seen_at_both_ends(link, standin):
    with running(standin, 1000, 3000) as process:
        results = []
        stream = observed(link, process.pid)
        for result in stream:
            results.append(result)
            if len(results) == 6:
                break
        stream.close()
    assert isinstance(results[0], Began)
    assert {probe.event for probe in results[0].placed} == {"publish", "take", "timer_call"}
    assert {refusal.reason.partition(":")[2][:17] for refusal in results[0].refused} == {" it was built wit"}
    published, taken = values_of(results, "publish"), values_of(results, "take")
    numbers = [hit.values["source_ns"] for hit in published]
    assert numbers == list(range(numbers[0], 3000))
    assert [hit.values["source_ns"] for hit in taken][-len(numbers) :] == numbers and len(taken) - len(numbers) <= 1
    assert {(hit.pid, hit.tid, hit.values["topic"]) for hit in (*published, *taken)} == {
        (process.pid, process.pid, "/a")
    }
    times = [hit.at_ns for result in results if isinstance(result, Batch) for hit in result.hits]
    assert times == sorted(times)
    # The first call has nothing to compare with.
    calls = values_of(results, "timer_call")
    assert "expected_ns" not in calls[0].values and calls[0].values["clock"] == "steady"
    late_ns = [hit.at_ns - hit.values["expected_ns"] for hit in calls[1:]]
    assert min(late_ns) > 0 and sorted(late_ns)[len(late_ns) // 2] < 10**9
    assert left() == []


def test_a_queued_callback_of_a_timer_is_late_by_when_it_begins(here, tmp_path):
    """Though its timer is called in time: as rclcpp's EventsExecutor does, which it says itself as well."""
    libraries = ("tracetools", "rcl", "rclcpp")
    program = standins.build(tmp_path / "queued", source=Path(__file__).with_name("queued.c"), libraries=libraries)
    accumulator = FlowAccumulator(begin_ns=0)
    with running(program, 1000) as process:
        accumulator.observe(observable.program for observable in find(here, process.pid))
        for result in observed(here, process.pid, for_s=6):
            if isinstance(result, Batch):
                accumulator.feed([*result.hits, *result.gaps])
        printed = dict(map(int, line.split()) for line in iter(process.stdout.readline, "done\n"))
    (stream,) = (stream for stream in streams(accumulator) if stream.kind is TIMER)
    late = dict(zip(stream.columns["expected_ns"].tolist(), stream.columns["real_ns"].tolist(), strict=True))
    assert len(late) > 500
    # A busy machine may do something else between the probe and the program's own look at the clock.
    differ = sorted(printed[due_ns] - begun_ns for due_ns, begun_ns in late.items())
    assert differ[0] >= 0 and differ[len(differ) // 2] < 500_000
    assert sum(begun_ns - due_ns > 10**7 for due_ns, begun_ns in late.items()) > len(late) / 20


def test_on_a_small_target(here, standin, tmp_path):
    """Its shell and its tools are BusyBox's."""
    scripts = standins.scripts_of_busybox(tmp_path)
    with running(standin, 1000, 10**9) as process:
        found = find(here, process.pid)
        placement = place(here, found, events=events())
        *results, last = observe(here, scripts, placement, found, for_s=3)
    numbers = [hit.values["source_ns"] for hit in values_of(results, "take")]
    assert numbers == list(range(numbers[0], numbers[-1] + 1)) and len(numbers) > 2000
    assert last.is_clean and left() == []


def test_the_end_of_the_time(link, standin):
    with running(standin, 100, 10**6) as process:
        *_, last = observed(link, process.pid, for_s=1.5)
    assert last == Finished(lost_events=0, rests=0, is_clean=True)
    assert left() == []


@pytest.mark.parametrize("way", ["local", "sshd"])
def test_a_runner_that_is_silent_leaves_nothing_and_goes_on(way, loopback, here, standin):
    """Its link is as dead as one whose cable was pulled: nothing ends. Later it goes on, and says so."""
    address = here.target.address if way == "local" else loopback.address
    code = textwrap.dedent(RUNNER.format(address=address, pid="{pid}"))
    short = (
        "from pathlib import PosixPath\nfrom rtrun.probes import session\nsession.BEAT_S, session.SILENCE_S = .5, 4\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with running(standin, 1000, 10**9) as process:
        code = short + code.replace("{pid}", str(process.pid))
        with running(sys.executable, "-c", code, env=environment) as runner:
            assert [runner.stdout.readline() for _ in range(8)] == ["Began\n"] + ["Batch\n"] * 7
            os.kill(runner.pid, signal.SIGSTOP)
            assert left() != []
            wait_until_nothing_is_left()
            os.kill(runner.pid, signal.SIGCONT)
            lines = []
            remark = "nothing was heard from rtrun for 4 s, so the probes were taken off; connecting"
            while remark not in "".join(lines):
                lines.append(runner.stdout.readline())
            # What was printed before the stop comes first.
            while not left():
                assert runner.stdout.readline() == "Batch\n"
    wait_until_nothing_is_left()


@pytest.mark.parametrize(
    ("way", "kills"),
    [
        ("local", (0, 1, 5)),
        ("sshd", (0, 1, 5)),
        pytest.param("local", range(30), marks=[pytest.mark.slow, pytest.mark.timeout(600)]),
    ],
    ids=str,
)
def test_a_killed_runner_leaves_nothing(way, kills, loopback, here, standin):
    address = here.target.address if way == "local" else loopback.address
    with running(standin, 1000, 10**9) as process:
        code = textwrap.dedent(RUNNER.format(address=address, pid=process.pid))
        code = f"from pathlib import PosixPath\n{code}"
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        for number in kills:
            with subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE) as runner:
                # At the beginning, while probes are placed, and later.
                if number % 3:
                    for _ in range(number % 6):
                        assert runner.stdout.readline()
                else:
                    while not left():
                        time.sleep(0.01)
                runner.kill()
            wait_until_nothing_is_left()
    assert process.returncode in (-signal.SIGKILL, None)


def test_a_cut_link(sshd, loopback, standin):
    standins.skip_without_trace()
    with proxy_to(sshd.port) as proxy, running(standin, 200, 10**9) as process:
        target = replace(loopback, address=replace(loopback.address, port=proxy.port), reconnect_s=30)
        with Link(target, print) as link:
            results, before = [], []
            stream = observed(link, process.pid)
            for result in stream:
                results.append(result)
                if len(results) == 4:
                    before = left()
                    proxy.cut()
                    wait_until_nothing_is_left()
                    proxy.mend()
                gaps = [gap for result in results if isinstance(result, Batch) for gap in result.gaps]
                if gaps and len(results) > 8:
                    break
            assert left() and before and not set(before) & set(left())
            stream.close()
    assert [gap.reason for gap in gaps] == ["the connection to the target was lost"]
    missing = [hit for hit in values_of(results, "publish") if gaps[0].from_ns < hit.at_ns < gaps[0].until_ns]
    assert not missing and gaps[0].until_ns > gaps[0].from_ns
    wait_until_nothing_is_left()


def test_leftovers_of_the_dead_alone_are_removed(here, standin):
    """Neither what a living one has, nor what others have, whatever their names look like."""
    namespace = str(Path("/proc/self/ns/pid").readlink())[5:-1]
    start = Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]
    living, dead = f"{namespace}_{os.getpid()}_{start}", f"{namespace}_{os.getpid()}_1"
    elsewhere = f"1_{os.getpid()}_1"
    names = (living, f"raw_{living}", dead, f"raw_{dead}", elsewhere)
    instances = [f"rtrun-observe-{name}" for name in names] + ["rtrun-observer", "others"]
    of_dead = {name for name in instances if name.endswith(dead)}
    groups = [f"rtrun_observe_{name}" for name in (living, dead, elsewhere)] + ["others"]
    with running(standin, 100, 10**9) as process:
        (found,) = find(here, process.pid)
        place_of = place(here, [found], events=["take"]).probes[0].line.split()[3]
        try:
            for name in instances:
                (TRACING / "instances" / name).mkdir()
            for group in groups:
                tell(f"p:{group}/x {place_of}")
                (TRACING / f"instances/rtrun-observe-{dead}/events" / group / "x" / "enable").write_text("1")
            *_, last = observed(here, process.pid, for_s=0.5)
            assert last.is_clean
            assert {path.name for path in (TRACING / "instances").iterdir()} & {*instances} == {*instances} - of_dead
            kept = (TRACING / "uprobe_events").read_text()
            assert [group for group in groups if f":{group}/x" in kept] == [groups[0], *groups[2:]]
        finally:
            for name in instances:
                if (TRACING / "instances" / name).exists():
                    (TRACING / "instances" / name / "events/enable").write_text("0")
                    (TRACING / "instances" / name).rmdir()
            for group in groups:
                if (TRACING / "events" / group).exists():
                    tell(f"-:{group}/x")


def test_two_at_once(here, loopback, standin):
    """Each sees everything, and takes off its own alone."""
    with running(standin, 500, 10**9) as process, Link(loopback, print) as other:
        first, second = observed(here, process.pid), observed(other, process.pid)
        assert isinstance(next(first), Began) and isinstance(next(second), Began)
        assert len([name for name in left() if name.startswith("rtrun-observe-")]) == 2
        first.close()
        assert len([name for name in left() if name.startswith("rtrun-observe-")]) == 1
        batches = [next(second) for _ in range(3)]
        numbers = [hit.values["source_ns"] for hit in values_of(batches, "take")]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))) and len(numbers) > 500
        second.close()
    wait_until_nothing_is_left()


def test_above_the_limit_the_probes_rest(here, standin):
    with running(standin, 4000, 10**9) as process:
        results = list(observed(here, process.pid, for_s=8, limit_per_s=2000))
    gaps = [gap for result in results if isinstance(result, Batch) for gap in result.gaps]
    assert gaps and {gap.reason for gap in gaps} == {"the probes rested: too many events"}
    taken = values_of(results, "take")
    # The end of the observation may end the last one.
    assert all(gap.until_ns - gap.from_ns > 10**9 for gap in gaps[:-1])
    numbers = [hit.values["source_ns"] for hit in taken]
    jumps = [b.at_ns for a, b in itertools.pairwise(taken) if b.values["source_ns"] != a.values["source_ns"] + 1]
    assert numbers and all(any(gap.from_ns < at < gap.until_ns + 10**8 for gap in gaps) for at in jumps)
    assert results[-1].rests == len(gaps) and results[-1].is_clean


@pytest.mark.parametrize("late_s", [0, 12])
def test_what_comes_while_a_round_is_printed_is_there_at_the_end(here, standin, late_s):
    """A round that had begun before the end is not the last one: it has read some CPUs already. Who reads late gets all
    of it, as far as a round has room."""
    published = 30_000
    with running(standin, 20_000, published, preexec_fn=lambda: os.sched_setaffinity(0, {0})) as process:
        found = find(here, process.pid)
        placement = place(here, found, events=EVENTS)
        lines = [*(probe.line for probe in placement.probes), "go", ""]
        argv = [SCRIPTS / "watch_probes.sh", "60", "30", "65536", "1000000", "nothing"]
        with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as script:
            script.stdin.write("\n".join(lines).encode())
            script.stdin.flush()
            # Nobody reads what is printed until all was published: the script stands still within a round.
            process.stdout.readline()
            script.stdin.close()
            time.sleep(late_s)
            printed = script.stdout.read()
            assert (script.wait(30), printed.endswith(b"\nrtrun end done\n")) == (0, True)
    reader = WatchReader({probe.name: probe for probe in placement.probes}, "here", {})
    taken = values_of([*reader.feed(printed), reader.rest()], "take")
    numbers = [hit.values["source_ns"] for hit in taken]
    assert len(numbers) > 1000 and numbers == list(range(numbers[0], published))


@pytest.mark.parametrize("way", ["end of the input", "signal", "killed"])
def test_nothing_sleeps_on_when_it_has_ended(here, standin, way):
    """Not for the ten minutes that it may observe, nor for the five in which nothing may be heard."""
    with running(standin, 100, 10**9) as process:
        found = find(here, process.pid)
        probes = place(here, found, events=EVENTS).probes
        argv = [SCRIPTS / "watch_probes.sh", "600", "300", "4096", "40000", "nothing"]
        with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as script:
            assert script.stdin is not None and script.stdout is not None
            script.stdin.write("\n".join([*(probe.line for probe in probes), "go", "", ""]).encode())
            script.stdin.flush()
            while b"round 2" not in script.stdout.readline():
                pass
            # Each line begins the silence anew.
            script.stdin.write(b"\n\n")
            script.stdin.flush()
            (inside,) = map(int, Path(f"/proc/{script.pid}/task/{script.pid}/children").read_text().split())
            if way != "end of the input":
                os.kill(inside, signal.SIGTERM if way == "signal" else signal.SIGKILL)
            script.stdin.close()
            # As long as something of it lives and could print.
            script.stdout.read()
            script.wait()
        deadline = time.monotonic() + 60
        while living := [folder.name for folder in Path("/proc").glob("[0-9]*") if is_of_session(folder, inside)]:
            assert time.monotonic() < deadline, living
            time.sleep(0.02)
        if way == "killed":
            # Its trace is taken off at the next start.
            assert left() != []
            list(observed(here, process.pid, for_s=0.1))
    assert left() == []


def is_of_session(process, number):
    try:
        state, _, _, session, *_ = (process / "stat").read_text(errors="replace").rpartition(") ")[2].split()
    except OSError:
        return False
    return state != "Z" and int(session) == number


def test_a_program_that_starts_later(here, standin):
    """It has another pid, and the probes on the file see it."""
    with running(standin, 100, 10**9) as first:
        stream = observed(here, first.pid)
        assert isinstance(next(stream), Began)
        next(stream)
        with running(standin, 100, 10**9) as second:
            results = [next(stream) for _ in range(4)]
            pids = {hit.pid for hit in values_of(results, "take")}
            programs = [found.program.pid for result in results for found in result.programs]
        assert {first.pid, second.pid} <= pids and second.pid in programs
        second_ended = [pid for _ in range(3) for pid in next(stream).ended]
        assert second.pid in second_ended
        stream.close()


def test_kernel_events_beside(here, standin):
    with running(standin, 100, 10**9) as process:
        results = list(observed(here, process.pid, for_s=2, kernel_events=["sched/sched_switch", "no/such"]))
    switches = [hit for result in results if isinstance(result, Batch) for hit in result.kernel]
    assert {hit.event for hit in switches} == {"sched/sched_switch"}
    woken = [hit for hit in switches if hit.values["next_pid"] == process.pid]
    assert woken and {hit.values["next_comm"] for hit in woken} == {"standin"}
    assert {hit.pid for hit in switches if hit.tid == process.pid} == {process.pid}


def test_a_library_of_a_mount_namespace(here, standin, tmp_path):
    """As in a container: by its path this machine has another file, or none."""
    moved = tmp_path / "inside"
    moved.mkdir()
    script = f"mount --bind {standin.parent} {moved} && exec {moved}/standin 100 1000000"
    with running("unshare", "--mount", "sh", "-c", script) as process:
        *results, last = observed(here, process.pid, for_s=2)
    assert values_of(results, "take") and last.is_clean
    assert any(probe.path.startswith(str(moved)) for probe in results[0].placed)


def test_libraries_in_folders_of_any_name(here, standin, tmp_path):
    """Their programs are seen, with megabytes of arguments, and so is another one with a copy of the same library."""
    more = [f"robot_description:={'<' * 120_000}"] * 15
    expected = set()
    with contextlib.ExitStack() as programs:
        for number, name in enumerate([b"a\\nb", b"a\nb", b"a#b", b"a b", b"\xff\xe2\x80\xa8"]):
            folder = os.fsencode(tmp_path) + b"/" + name
            shutil.copytree(os.fsencode(standin.parent), folder)
            argv = [folder + b"/standin", "100", "1000000", "0", "1", f"/own{number}", "-1", *more]
            odd = programs.enter_context(subprocess.Popen(argv))
            programs.callback(odd.kill)
            expected.add((odd.pid, f"/own{number}"))
        other = programs.enter_context(running(standin, 100, 10**9))
        expected.add((other.pid, "/a"))
        *results, last = observed(here, *(pid for pid, _ in expected), for_s=2)
    assert {(hit.pid, hit.values["topic"]) for hit in values_of(results, "take")} == expected and last.is_clean


def programs_of(link, path):
    """The pids of those that are called by a path below this one."""
    return [
        program.program.pid
        for program in find_programs(link, SCRIPTS).found
        if program.program.argv[0].startswith(path)
    ]


def test_two_containers_of_one_image(here, standin, tmp_path):
    """Each has the library by a path and a file system of its own: the file is one, and every call is seen once."""
    mounts = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        parts = f"lowerdir={standin.parent},upperdir={folder}/upper,workdir={folder}/work"
        mounts += [f"mount -t tmpfs none {folder}", f"mkdir {folder}/upper {folder}/work {folder}/root"]
        mounts += [f"mount -t overlay none -o {parts} {folder}/root"]
    wrapper = ["unshare", "--mount", "sh", "-c", " && ".join([*mounts, 'exec "$@"']), "sh"]
    if subprocess.run([*wrapper, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user, or this kernel, may not mount an overlay")
    # They end with the standard input.
    start = f'{tmp_path}/$name/root/standin 100 1000000 & pids="$pids $!"'
    both = f"for name in a b; do {start}; done; read -r _; kill $pids"
    with subprocess.Popen([*wrapper, "sh", "-c", both], stdin=subprocess.PIPE) as process:
        try:
            deadline = time.monotonic() + 30
            while len(pids := programs_of(here, str(tmp_path))) < 2:
                assert time.monotonic() < deadline and process.poll() is None
            *results, last = observed(here, *pids, for_s=2)
        finally:
            process.stdin.close()
    for pid in pids:
        numbers = [hit.values["source_ns"] for hit in values_of(results, "take") if hit.pid == pid]
        assert len(numbers) > 100 and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert last.is_clean


def test_a_program_without_the_library_that_tells_the_release(here, standin):
    """It is found first, and its own probes cannot be placed; those of the others are."""
    code = "import ctypes, sys; ctypes.CDLL(sys.argv[1]); input()"
    argv = [sys.executable, "-c", code, standin.parent / "libtracetools.so"]
    with running(*argv, stdin=subprocess.PIPE) as without, running(standin, 100, 10**9) as other:
        found = sorted(find(here, without.pid, other.pid), key=lambda program: program.program.pid != without.pid)
        placement = place(here, found, events=EVENTS)
        *results, last = observe(here, SCRIPTS, placement, found, for_s=1)
        alone = place(here, found[:1], events=EVENTS)
    assert {"publish", "take"} <= {probe.event for probe in placement.probes}
    assert {hit.pid for hit in values_of(results, "take")} == {other.pid} and last.is_clean
    (reason,) = {refusal.reason for refusal in alone.refused if refusal.event == "publish"}
    assert reason.endswith("which librcl tells: the program does not map it")


def test_a_library_that_was_replaced(here, tmp_path):
    program = standins.build(tmp_path / "replaced")
    with running(program, 100, 10**9) as process:
        find(here, process.pid)
        (program.parent / "libtracetools.so").unlink()
        (began, *_, last) = observed(here, process.pid, for_s=0.5)
    assert [(Path(refusal.path).name, refusal.reason) for refusal in began.refused] == [
        ("libtracetools.so", "its file was replaced while the program runs: restart the program")
    ]
    assert [probe.event for probe in began.placed] == ["timer_call"] and last.is_clean


def test_a_probe_that_the_kernel_refuses(here, standin):
    """The others are placed all the same."""
    with running(standin, 100, 10**9) as process:
        found = find(here, process.pid)
        placement = place(here, found, events=events())
        bad = replace(placement.probes[0], line=placement.probes[0].line.replace("%di", "%nonsense"))
        placement = replace(placement, probes=(bad, *placement.probes[1:]))
        began, *_ = observe(here, SCRIPTS, placement, found, for_s=0.5)
    (refused,) = [refusal for refusal in began.refused if refusal.event == bad.event]
    assert "egister" in refused.reason or "does not take it" in refused.reason
    assert len(began.placed) == len(placement.probes) - 1


def test_no_right_to_it(here, loopback, standin, tmp_path):
    """The reason is one line."""
    with running(standin, 100, 10**9) as process:
        found = find(here, process.pid)
        placement = place(here, found, events=events())
        script = tmp_path / "watch_probes.sh"
        # Where there is no tracefs, and none can be mounted.
        text = (
            (Path(str(SCRIPTS)) / "watch_probes.sh").read_text().replace("/sys/kernel/tracing", str(tmp_path / "none"))
        )
        script.write_text(text)
        script.chmod(0o755)
        shutil.copy(SCRIPTS / "processes.sh", tmp_path)
        with pytest.raises(TargetError, match=r"this machine: no kernel trace: it needs CONFIG_FTRACE"):
            list(observe(here, PurePosixPath(tmp_path), placement, found, for_s=5))
