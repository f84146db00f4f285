"""Other programs as benchmarks and tests of memory limits measure them: each for itself.

What the kernel says of a child's highest memory (`ru_maxrss`) begins with the size of the process that it was forked
from, and keeps that across exec. So a small process stands between: it forks, and waits for the program.
"""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

# In isolation and without site it has less than 10 MiB; a smaller program is reported with as much.
_LAUNCHER = """
import os, signal, sys
out = int(sys.argv[1])
os.set_inheritable(out, False)
pid = os.fork()
if pid == 0:
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execvp(sys.argv[2], sys.argv[2:])
    except OSError as error:
        os.write(2, f"{sys.argv[2]}: {error}".encode())
        os._exit(127)
_, status, used = os.wait4(pid, 0)
os.write(out, f"{os.waitstatus_to_exitcode(status)} {used.ru_utime + used.ru_stime} {used.ru_maxrss}".encode())
"""
_PEAK = re.compile(r"^VmHWM:\s*(\d+) kB$", re.MULTILINE)
_Output = int | IO[bytes]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """How a program ended, and what it used with all that it started and waited for."""

    status: int
    """Exit status; -N if signal N ended it."""
    stdout: str
    stderr: str
    cpu_s: float
    """Processor time, user and system."""
    peak_mib: float
    """The most physical memory that it had at one time; that of the largest process, if it started others."""


def measured(
    argv: Sequence[str | Path],
    *,
    check: bool = True,
    timeout_s: float | None = None,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    output: _Output = subprocess.PIPE,
) -> Measured:
    """Run a program to its end. Its output is returned, or goes to the file `output`.

    Raises:
        subprocess.CalledProcessError: with `check`, where the exit status is not 0.
        subprocess.TimeoutExpired: it was ended, and its process group.
    """
    reading, writing = os.pipe()
    with os.fdopen(reading) as report:
        words = [sys.executable, "-I", "-S", "-c", _LAUNCHER, str(writing), *map(str, argv)]
        try:
            process = subprocess.Popen(
                words,
                cwd=cwd,
                env=env,
                stdout=output,
                stderr=output,
                pass_fds=[writing],
                start_new_session=True,
                text=True,
            )
        finally:
            os.close(writing)
        try:
            stdout, stderr = process.communicate(timeout=timeout_s)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise
        status, cpu_s, peak_kib = report.read().split()
    if check and status != "0":
        raise subprocess.CalledProcessError(int(status), list(map(str, argv)), stdout, stderr)
    return Measured(
        status=int(status), stdout=stdout or "", stderr=stderr or "", cpu_s=float(cpu_s), peak_mib=int(peak_kib) / 1024
    )


def own_peak_mib() -> float:
    """The most memory that this process had at one time, in MiB, since it was executed."""
    peak = _PEAK.search(Path("/proc/self/status").read_text())
    assert peak is not None
    return int(peak[1]) / 1024
