"""What find_programs.sh prints of real processes, and what is refused."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probes.standin import SCRIPTS, find, running

from rtrun.probes.programs import parse_programs, pattern
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link


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
        each
        for each in link.check([str(SCRIPTS / "find_programs.sh"), pattern()]).splitlines()
        if each == f"program {process.pid}"
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


STAT = "1 (x) S 1 1 1 0 -1 4194368 1 0 0 0 0 0 0 0 20 0 18 0 227595 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 17 1 0 0 0 0 0"
GOOD = f"program 1\nargument x\nlocked 4 kB\nstat {STAT}\ncpus 1 0-3\nmaps 1-2 fe:00 5 /x/librcl.so\nend 1\n"


def test_one_in_words():
    (found,) = parse_programs(GOOD, "board")
    assert (found.program.locked_bytes, found.program.start_ticks, found.program.threads[0].cpus) == (
        4096,
        227595,
        (0, 1, 2, 3),
    )
    assert (found.mapped[0].library, found.mapped[0].is_deleted) == ("librcl", False)


def test_a_thread_with_too_few_numbers_is_none():
    cut = re.sub(r"(stat 1 .*?\)(?: \S+){36}).*", r"\1", GOOD)
    assert cut != GOOD and parse_programs(cut, "board") == ()


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
        "".join(GOOD.replace("m 1\n", f"m {n}\n").replace("d 1\n", f"d {n}\n").replace(" 1 ", f" {n} ", 2)
                for n in range(1, 2100)),
    ],
)  # fmt: skip
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
