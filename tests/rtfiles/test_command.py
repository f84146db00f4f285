"""What ends a command becomes one line and an exit status."""

import signal
import time
import types

import pytest

from rtfiles.command import dispatch
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.output import noting_duration, print_line, print_note


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (UsageError("a.yml: wrong"), 2, "a.yml: wrong"),
        (InfrastructureError("board: gone"), 3, "board: gone"),
        (PermissionError(13, "Permission denied", "/a/file"), 3, "/a/file: Permission denied"),
        (OSError(28, "No space left on device"), 3, "No space left on device"),
        (TimeoutError("timed out"), 3, "timed out"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_an_error_is_a_line(capsys, error, status, line):
    def run(_args):
        raise error

    command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    assert dispatch("prog", "A program.", [command], ["do"]) == status
    assert capsys.readouterr().err == f"prog: {line}\n"


@pytest.mark.parametrize("words", [["do"], ["do", "-q"], ["do", "--quiet"]])
def test_quiet_leaves_the_answer_and_errors(capsys, words):
    def run(_args):
        print_note("a remark")
        with noting_duration("the work"):
            print_line("the answer")
        raise UsageError("what is wrong")

    command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    assert dispatch("prog", "A program.", [command], words) == 2
    printed = capsys.readouterr()
    assert printed.out == "the answer\n"
    remarks = "a remark\nthe work: 0 s\n" if words == ["do"] else ""
    assert printed.err == f"{remarks}prog: what is wrong\n"
    print_note("later")
    assert capsys.readouterr().err == "later\n"


@pytest.mark.parametrize("error", [ValueError("bad\x1b[2Jvalue"), RecursionError(), MemoryError(), AssertionError()])
def test_what_nobody_expected_is_a_defect_with_a_traceback(capsys, error):
    def run(_args):
        raise error

    command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    assert dispatch("prog", "A program.", [command], ["do"]) == 70
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Traceback (most recent call last):" and "raise error" in " ".join(lines)
    assert not any("\x1b" in line for line in lines)
    assert lines[-1] == "prog: a defect of prog; please report it with the lines above"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_told_to_end_cleans_up(capsys, number):
    previous = signal.signal(number, signal.SIG_DFL)  # the tests may run under nohup
    cleaned = []

    def run(_args):
        try:
            signal.raise_signal(number)
            time.sleep(60)
        finally:
            cleaned.append(True)

    command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    try:
        assert dispatch("prog", "A program.", [command], ["do"]) == 130
        assert cleaned and capsys.readouterr().err == "prog: interrupted\n"
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, previous)


def test_a_hang_up_that_nohup_ignores(monkeypatch):
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:

        def run(_args):
            signal.raise_signal(signal.SIGHUP)
            return 0

        command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
        assert dispatch("prog", "A program.", [command], ["do"]) == 0
    finally:
        signal.signal(signal.SIGHUP, previous)


def test_a_pipe_that_breaks_elsewhere_is_no_success(capsys):
    def run(_args):
        raise BrokenPipeError(32, "Broken pipe")

    command = types.SimpleNamespace(__name__="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    assert dispatch("prog", "A program.", [command], ["do"]) == 3
    assert capsys.readouterr().err == "prog: Broken pipe\n"
