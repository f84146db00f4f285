"""What ends a command becomes one line and an exit status."""

import types

import pytest

from rtfiles.command import dispatch
from rtfiles.errors import InfrastructureError, UsageError


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

    command = types.SimpleNamespace(NAME="do", HELP="do it", add_arguments=lambda _parser: None, run=run)
    assert dispatch("prog", "A program.", [command], ["do"]) == status
    assert capsys.readouterr().err == f"prog: {line}\n"
