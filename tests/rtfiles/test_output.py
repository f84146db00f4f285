"""What is printed cannot command a terminal, and what happens to the output does not change the answer."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rtfiles import output

# A program of one command: it prints, goes on, says on standard error that it went on, and ends with the status of
# its answer.
PROGRAM = """
import argparse, sys, types
from rtfiles.command import dispatch
from rtfiles.output import console, print_line, print_note, print_text

def run(args):
    for number in range(args.lines):
        print_line(f"line {number}")
    print_text("several\\nlines")
    console().print("a table")
    print("from a library")
    print_note("measured to the end")
    return args.status

def add_arguments(parser):
    parser.add_argument("status", type=int, help="0 … 255")
    parser.add_argument("--lines", type=int, default=20_000)

command = types.SimpleNamespace(__name__="do", HELP="do it…", add_arguments=add_arguments, run=run)
sys.exit(dispatch("prog", "A program…", [command], None))
"""


def start(*arguments: str, **streams) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **streams.pop("env", {})},
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
    )


@pytest.mark.parametrize("status", [0, 1, 3])
@pytest.mark.parametrize("lines", ["0", "20000"])  # within what a pipe and our buffers take, and more than that
def test_a_reader_that_goes_away_changes_nothing(status, lines):
    process = start("do", str(status), "--lines", lines)
    process.stdout.close()
    assert process.stderr.read().decode() == "measured to the end\n"
    assert process.wait() == status


def test_a_reader_that_takes_one_line(tmp_path):
    process = start("do", "1")
    assert process.stdout.readline() == b"line 0\n"
    process.stdout.close()
    assert process.stderr.read().decode() == "measured to the end\n"
    assert process.wait() == 1


@pytest.mark.parametrize(("status", "expected"), [(0, 3), (1, 1)])
def test_a_full_disk_is_no_success(status, expected):
    with Path("/dev/full").open("wb") as full:
        process = start("do", str(status), stdout=full)
    assert process.stderr.read().decode() == ("measured to the end\nprog: standard output: No space left on device\n")
    assert process.wait() == expected


@pytest.mark.parametrize("closed", ["1", "2", "0 1 2"])
def test_closed_streams_are_filled_before_a_file_takes_their_number(tmp_path, closed):
    # Whatever is opened first would become standard error, and would receive what C code prints there.
    program = PROGRAM.replace("return args.status", f"file = open({str(tmp_path / 'a')!r}, 'w'); return file.fileno()")
    close = "".join(f"os.close({number});" for number in closed.split())
    command = f"import os,sys;{close}os.execv(sys.executable, [sys.executable, '-c', sys.argv[1], 'do', '0'])"
    done = subprocess.run(
        [sys.executable, "-c", command, program],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        check=False,
    )
    assert done.returncode > 2
    assert done.stdout.decode() == "" or closed == "2"


@pytest.mark.parametrize("where", ["closed", "/dev/full"])
def test_standard_error_that_takes_nothing_changes_nothing(where):
    if where == "closed":
        process = start("do", "1", "--lines", "1")
        process.stderr.close()
    else:
        with Path(where).open("wb") as full:
            process = start("do", "1", "--lines", "1", stderr=full)
    assert process.stdout.read().decode() == "line 0\nseveral\nlines\na table\nfrom a library\n"
    assert process.wait() == 1


@pytest.mark.parametrize("arguments", [["--help"], ["do", "--help"]])
def test_help_on_a_terminal_that_knows_ascii_alone(arguments):
    process = start(*arguments, env={"PYTHONIOENCODING": "ascii:strict"})
    text, errors = process.communicate()
    assert (process.returncode, errors) == (0, b"") and b"..." in text and b"?" not in text


@pytest.mark.parametrize(("arguments", "status"), [(["--help"], 0), (["do", "none"], 2)])
def test_help_that_nobody_reads(arguments, status):
    process = start(*arguments)
    process.stdout.close()
    process.stderr.close()
    assert process.wait() == status


def test_text_of_a_target_cannot_command_the_terminal(capsys):
    hostile = "a\x1b[2Jb\x07\r\nc\x9b1m\u202e\ud800\td"
    output.print_line(hostile)
    output.print_note(hostile)
    seen = capsys.readouterr()
    assert seen.out == seen.err == "a?[2Jb???c?1m??\td\n"
    output.print_text("{\n  \x1b\u2028\n}\n")
    assert capsys.readouterr().out == "{\n  ??\n}\n"


def test_a_line_is_seen_at_once():
    program = "from rtfiles.output import *\nwith surviving_output():\n    print_line('now')\n    input()\n"
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout.readline() == b"now\n"
    process.communicate(b"\n")
    assert process.returncode == 0


def test_programs_that_are_started_get_streams_in_place_of_closed_ones():
    program = (
        "import subprocess, sys\nfrom rtfiles.output import surviving_output\nwith surviving_output():\n"
        "    test = '[ -e /proc/$$/fd/0 ] && [ -e /proc/$$/fd/1 ] && [ -e /proc/$$/fd/2 ]'\n"
        "    sys.exit(subprocess.run(['sh', '-c', test]).returncode)\n"
    )
    close = (
        "import os,sys;os.close(0);os.close(1);os.close(2);os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run([sys.executable, "-c", close, "-c", program], env=environment, check=False).returncode == 0


def test_how_long_it_took_is_a_note(capsys):
    with output.noting_duration("building"):
        print("built")
    printed = capsys.readouterr()
    assert printed.out == "built\n" and re.fullmatch(r"building: [0-9]+ s\n", printed.err)


def test_what_failed_has_no_duration(capsys):
    with pytest.raises(OSError), output.noting_duration("building"):
        raise OSError
    assert capsys.readouterr().err == ""
