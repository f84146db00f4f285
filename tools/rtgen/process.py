"""The one way in which rtgen starts other programs."""

import os
import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from rtfiles.errors import InfrastructureError

TIMEOUT_S = 900
# How long a program may take to clean up after SIGTERM; mmdebstrap removes its mounts and files then.
GRACE_S = 60
POLL_S = 0.05
SHOWN_LINES = 20


def run(
    command: Sequence[str | Path],
    *,
    stdin: bytes | None = None,
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
    timeout_s: float = TIMEOUT_S,
) -> str:
    """Run a program in a folder and return its standard output. `environment` replaces ours.

    When the time is over or we are interrupted, the program and what it started get SIGTERM and `GRACE_S` to clean
    up; then whatever still runs is killed. When we are killed, the program gets SIGTERM. Raises InfrastructureError
    when it is not installed, takes too long, or fails; the message ends with the last lines of its output.
    """
    arguments = [str(word) for word in command]
    # Files, not pipes: if we are killed, a program that prints while it cleans up would die of a broken pipe.
    with tempfile.TemporaryFile() as output_file, tempfile.TemporaryFile() as errors_file:
        try:
            process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "TERM", *arguments],
                stdin=subprocess.DEVNULL if stdin is None else subprocess.PIPE,
                stdout=output_file,
                stderr=errors_file,
                cwd=folder,
                env=environment,
                process_group=0,
            )
        except FileNotFoundError as error:
            raise InfrastructureError("setpriv is not installed: tools/setup installs it") from error
        try:
            process.communicate(stdin, timeout=timeout_s)
        except BaseException as error:
            _end(process)
            if isinstance(error, subprocess.TimeoutExpired):
                raise InfrastructureError(f"{arguments[0]} did not end within {timeout_s:g} s") from error
            raise
        output_file.seek(0)
        errors_file.seek(0)
        output, errors = output_file.read(), errors_file.read()
    if process.returncode == 127:
        raise InfrastructureError(f"{arguments[0]} is not installed: `tools/setup all` installs it")
    if process.returncode != 0:
        lines = (output + errors).decode(errors="replace").strip().splitlines()[-SHOWN_LINES:] or ["(no output)"]
        text = "\n  ".join(lines)
        raise InfrastructureError(f"exit status {process.returncode} of {shlex.join(arguments)}\n  {text}")
    return output.decode(errors="replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    # The group keeps its number until the program is waited for.
    if process.returncode is None:
        # The whole group, as with Ctrl-C in a terminal: mmdebstrap waits for its apt-get before it cleans up.
        os.killpg(process.pid, signal.SIGTERM)
        deadline = time.monotonic() + GRACE_S
        while os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None:
            if time.monotonic() >= deadline:
                break
            time.sleep(POLL_S)
        # The program may have left other processes behind.
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
