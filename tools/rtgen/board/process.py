"""Programs run to their end, or ended and cleaned up after."""

import shlex
import subprocess
from collections.abc import Sequence

from rtfiles.errors import InfrastructureError, UsageError

# mmdebstrap removes its mounts and files on SIGTERM: that long it may take.
GRACE_S = 20


def run(command: Sequence[str], stdin: bytes | None = None, timeout_s: float = 900) -> str:
    """Run a program and return its standard output.

    It gets SIGTERM when we are interrupted or die, and is waited for, so that it can clean up (``subprocess.run``
    would kill it). Raises UsageError when it is not installed, InfrastructureError with its last words when it fails.
    """
    watched = ["setpriv", "--pdeathsig", "TERM", *command]
    process = subprocess.Popen(
        watched,
        stdin=subprocess.DEVNULL if stdin is None else subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        output, errors = process.communicate(stdin, timeout=timeout_s)
    except BaseException as error:
        process.terminate()
        try:
            process.communicate(timeout=GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        if isinstance(error, subprocess.TimeoutExpired):
            raise InfrastructureError(f"{command[0]} did not end within {timeout_s:g} s") from error
        raise
    if process.returncode == 127:
        raise UsageError(f"{command[0]} is not installed, see tools/apt-packages.txt")
    if process.returncode != 0:
        words = errors.decode(errors="replace").strip().splitlines()[-8:] or ["(it said nothing)"]
        said = "\n  ".join(words)
        raise InfrastructureError(f"exit status {process.returncode} of: {shlex.join(command)}\n  {said}")
    return output.decode(errors="replace")
