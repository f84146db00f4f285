"""What find_programs.sh prints of real processes, and what is refused."""

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probes.standin import SCRIPTS, find, running

from rtrun.flows.programs import label_of
from rtrun.probes.programs import CPU_SETS_MAX, PROGRAMS_MAX, Roster, pattern
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link
from watched import parse_programs


@pytest.fixture
def link(loopback):
    with Link(loopback, print) as link:
        yield link


def test_a_process_as_it_is(link, standin):
    argv = [str(standin), "10", "1000000", "with\nnewline", "", "ä \\"]
    # Its name, as any thread may call itself.
    with running(*argv, preexec_fn=lambda: os.sched_setaffinity(0, {0})) as process:
        (found,) = find(link, process.pid)
        program = found.program
        assert program.argv == tuple(argv) and program.name == "standin"
        start = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[19]
        assert program.start_ticks == int(start) and program.locked_bytes == 0
        (thread,) = program.threads
        assert (thread.tid, thread.policy, thread.priority, thread.cpus) == (process.pid, "OTHER", 0, (0,))
        assert set(program.libraries) == {str(standin.parent / f"lib{name}.so") for name in ("rcl", "tracetools")}
    assert not [
        line
        for line in link.check([str(SCRIPTS / "find_programs.sh"), pattern()]).splitlines()
        if line == f"program {process.pid}"
    ]


def test_a_real_time_thread_with_any_name(link, standin, tmp_path):
    """As a program calls itself whose file has this name."""
    program = tmp_path / "a) R 1\n("
    shutil.copytree(standin.parent, tmp_path / "libraries")
    shutil.copy(standin, program)
    environment = os.environ | {"LD_LIBRARY_PATH": str(tmp_path / "libraries")}
    chrt = ["chrt", "--fifo", "7"]
    if subprocess.run([*chrt, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may not use real-time policies")
    with running(*chrt, program, "10", "1000000", env=environment) as process:
        (found,) = find(link, process.pid)
        (thread,) = found.program.threads
    assert (thread.name, thread.policy, thread.priority) == ("a) R 1\n(", "FIFO", 7)


# A folder as a program may have one: bytes that are no UTF-8, what ends a line or a word, what a shell reads.
FOLDER = b"a\nb\\nc \\012 #\xff\xe2\x80\xa8 $(x)"


def test_whatever_arguments_and_paths_are(link, standin, tmp_path):
    """The beginning of the arguments, and the name of the node wherever it stands."""
    folder = os.fsencode(tmp_path) + b"/" + FOLDER
    shutil.copytree(os.fsencode(standin.parent), folder)
    large = b"robot_description:=" + b"<\xff\n>" * 25_000
    argv = [
        folder + b"/standin",
        b"10",
        b"1000000",
        large,
        b"-r",
        b"__node:=a",
        b"x" * 100_000,
        b"__ns:=/b",
    ]
    with subprocess.Popen(argv) as process:
        try:
            (found,) = find(link, process.pid)
        finally:
            process.kill()
    program = found.program
    assert program.argv[0].endswith("/standin") and "a\nb" in program.argv[0] and "\\xff" in program.argv[0]
    assert program.argv[3].startswith("robot_description:=<\\xff\n>") and program.argv[3].endswith("…")
    assert program.argv[4:] == ("…", "__node:=a", "__ns:=/b") and label_of(program) == "/b/a"
    assert {path.rpartition("/")[2] for path in program.libraries} == {"librcl.so", "libtracetools.so"}


def test_many_programs_with_megabytes_of_arguments(link, standin):
    """More than a command may print that is read whole."""
    arguments = [f"{number}:{'x' * 120_000}" for number in range(15)]
    with contextlib.ExitStack() as stack:
        processes = [stack.enter_context(running(standin, 10, 10**6, *arguments)) for _ in range(8)]
        found = find(link, *(process.pid for process in processes))
    assert {len(" ".join(observable.program.argv)) < 5000 for observable in found} == {True}


def test_what_a_thread_is_called_makes_no_other_thread(link, standin):
    """A name as "\\n57 (a" begins a line."""
    code = "import ctypes, sys; ctypes.CDLL(sys.argv[1]); open('/proc/self/comm', 'w').write('\\n57 (a) R 1'); input()"
    argv = [sys.executable, "-c", code, standin.parent / "librcl.so"]
    with running(*argv, stdin=subprocess.PIPE) as process:
        (found,) = find(link, process.pid)
        deadline = time.monotonic() + 30
        while found.program.name != "\n57 (a) R 1":
            assert time.monotonic() < deadline
            (found,) = find(link, process.pid)
    assert [thread.tid for thread in found.program.threads] == [process.pid]


def test_more_processes_than_a_command_line_holds(link, standin):
    """They are named on the standard input."""
    with running(standin, 10, 10**6) as process:
        find(link, process.pid)
        pids = "".join(f"{pid}\n" for pid in (*range(10**6, 10**6 + 300_000), process.pid))
        printed = link.check([str(SCRIPTS / "find_programs.sh"), pattern(), "-"], stdin=pids)
    (found,) = parse_programs(printed, "board").found
    assert found.program.pid == process.pid


STAT = "1 (x) S 1 1 1 0 -1 4194368 1 0 0 0 0 0 0 0 20 0 18 0 227595 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 17 1 0 0 0 0 0"
GOOD = f"program 1\nargument x\nlocked 4 kB\nstat {STAT}\ncpus 1 0-3\nmaps 1-2 fe:00 5 /x/librcl.so\nend 1\n"


def good(pid, thread_lines=1, argument="x"):
    """What is printed of a program with so many threads."""
    threads = [f"stat {pid + number} (x){STAT[5:]}" for number in range(thread_lines)]
    lines = [f"program {pid}", f"argument {argument}", *threads, "maps 1-2 fe:00 5 /x/librcl.so", f"end {pid}"]
    return "".join(f"{line}\n" for line in lines)


@pytest.mark.parametrize(
    ("text", "found", "left_out"),
    [
        ("".join(map(good, range(1, PROGRAMS_MAX + 101))), PROGRAMS_MAX, 100),
        # The next ones are there all the same.
        (good(1, 11_000) + good(20_000, 11_000) + good(40_000), 2, 1),
        ("".join(good(pid, argument="y" * 60_000) for pid in range(1, 600)) + good(1000), 279, 321),
        ("".join(good(pid, argument="\U0001f916" + "y" * 59_999) for pid in range(1, 100)), 69, 30),
    ],
    ids=["programs", "threads", "texts", "wide texts"],
)
def test_what_is_beyond_a_limit_is_left_out(text, found, left_out):
    listing = parse_programs(text, "board")
    assert (len(listing.found), listing.left_out) == (found, left_out)
    roster = Roster(listing.found)
    for observable in parse_programs(text.replace("227595", "227596"), "board").found:
        roster.begin(observable.program)
    # They live instead of those that had the pids before, and all that were there have no more room.
    assert len(roster.alive) == found and {program.start_ticks for program in roster.alive} == {227596}
    assert len(roster.seen) <= max(found, PROGRAMS_MAX) and roster.left_out >= found - 1
    for pid in [program.pid for program in roster.alive]:
        roster.end(pid)
    assert roster.alive == ()


def test_threads_that_may_run_on_the_same_cpus_share_them():
    lines = [f"cpus {tid} {tid % 300}-8191" for tid in range(1, 1000)]
    text = good(1, 999).replace("maps", "\n".join(lines) + "\nmaps")
    (found,) = parse_programs(text, "board").found
    sets = {id(thread.cpus) for thread in found.program.threads}
    assert len(found.program.threads) == 999 and len(sets) <= 257


def test_sets_of_cpus_are_limited_over_all_listings():
    roster = Roster(())
    for number in range(10):
        lines = "".join(f"cpus {tid} {number}-{1000 + tid}\n" for tid in range(1, 101))
        (found,) = parse_programs(good(1, 100).replace("maps", f"{lines}maps"), "board").found
        roster.begin(replace(found.program, start_ticks=number))
    kept = {thread.cpus for program in roster.seen for thread in program.threads}
    assert len(roster.seen) == 10 and len(kept) == CPU_SETS_MAX + 1


def test_one_in_words():
    (found,) = parse_programs(GOOD, "board").found
    assert (found.program.locked_bytes, found.program.start_ticks, found.program.threads[0].cpus) == (
        4096,
        227595,
        (0, 1, 2, 3),
    )
    assert (found.mapped[0].library, found.mapped[0].is_deleted) == ("librcl", False)


def test_a_thread_with_too_few_numbers_is_none():
    cut = re.sub(r"(stat 1 .*?\)(?: \S+){36}).*", r"\1", GOOD)
    assert cut != GOOD and parse_programs(cut, "board").found == ()


@pytest.mark.parametrize(
    "text",
    [
        "x\n",
        "program 0\nend 0\n",
        "program 1\n",
        GOOD.replace("0-3", "0-99999"),
        GOOD.replace("0-3", "3-0"),
        GOOD.replace("4 kB", f"{2**70} kB"),
        GOOD.replace("maps 1-2", "maps x"),
        GOOD + "program 99999999999\n",
    ],
)
def test_what_is_refused(text):
    with pytest.raises(TargetError, match=r"board: what find_programs\.sh printed cannot be read: "):
        parse_programs(text, "board")


@settings(max_examples=200)
@given(st.data())
def test_no_other_exception(data):
    lines = GOOD.splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(lines) - 1))
        lines[place] = data.draw(st.text(max_size=40) | st.sampled_from(lines).map(lambda line: line[:-2] + "9"))
    try:
        parse_programs("\n".join(lines), "board")
    except TargetError as error:
        assert "\n" not in str(error)
