"""One program on the target, detached: started once, waited for, ended, whatever happens to the connection."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath

from rtrun.errors import DeadlineExpired, TargetError
from rtrun.link import Link

# One wait lasts at most this long, so that a board that died is noticed while we wait.
WAIT_S = 15.0
POLL_S = 0.1

_WAIT = 'flock -s "$1.lock" true; cat "$1.exit" 2>/dev/null; [ -e "$1.expired" ] && echo expired; exit 0'
_END = """
# A pid of another boot is some other process now.
[ "$(cat "$1.boot_id" 2>/dev/null)" = "$(cat /proc/sys/kernel/random/boot_id)" ] || exit 0
for _ in 1 2 3 4 5; do [ -s "$1.pid" ] || sleep 0.1; done
[ -s "$1.pid" ] || exit 0
kill -TERM "-$(cat "$1.pid")" 2>/dev/null || exit 0
for _ in 1 2 3 4 5 6 7 8 9 10; do flock -n "$1.lock" true && exit 0; sleep 0.2; done
kill -KILL "-$(cat "$1.pid")" 2>/dev/null
exit 0
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """A program of a run: `argv` with its whole path, `environment` on top of the login's."""

    name: str
    argv: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()
    deadline_s: float = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Exit:
    """How a program ended: its status, or None when something else than the program ended it."""

    status: int | None
    expired: bool


def start(link: Link, scripts: PurePosixPath, folder: PurePosixPath, program: Program, setup: str | None) -> None:
    """Start a program in a folder of the target, unless it was started there already."""
    env = ["env", *(f"{name}={value}" for name, value in program.environment)] if program.environment else []
    supervise = str(scripts / "supervise.sh")
    deadline = str(max(1, round(program.deadline_s)))
    command = [supervise, str(folder), program.name, deadline, setup or "", *env, *program.argv]
    link.do(lambda connection: connection.check(command))


def wait(link: Link, folder: PurePosixPath, name: str, *, deadline_s: float) -> Exit:
    """Wait for the end of a program; the target spends nothing on it meanwhile.

    Raises DeadlineExpired when it has not ended in time, TargetGone and TargetRebooted.
    """
    deadline = time.monotonic() + deadline_s
    command = ["sh", "-c", _WAIT, "sh", str(folder / name)]
    while True:
        slice_s = min(WAIT_S, max(0.1, deadline - time.monotonic()))
        try:
            said = link.do(lambda connection: connection.check(command, deadline_s=slice_s)).split()  # noqa: B023
        except DeadlineExpired:
            if failure := link.target.failure():
                raise failure from None
            if time.monotonic() >= deadline:
                raise
            continue
        status = int(said[0]) if said and said[0].isdigit() else None
        return Exit(status=status, expired="expired" in said)


def end(link: Link, folder: PurePosixPath, name: str) -> None:
    """End a program and everything it started, if it still runs."""
    link.do(lambda connection: connection.run(["sh", "-c", _END, "sh", str(folder / name)]))


def tail(link: Link, path: PurePosixPath) -> str:
    """Return the last line of a file on the target, for a message; empty when there is none."""
    result = link.do(lambda connection: connection.run(["tail", "-n", "1", str(path)]))
    return result.stdout.strip()[:500]


def ended(link: Link, folder: PurePosixPath, name: str) -> bool:
    """Say whether a program that was started has ended."""
    command = ["flock", "-n", "-s", str(folder / f"{name}.lock"), "true"]
    return link.do(lambda connection: connection.run(command)).status == 0


def until(condition: Callable[[], bool], *, deadline_s: float, what: str) -> None:
    """Ask until a condition holds. Raises TargetError ``waited … s for <what>``."""
    deadline = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() >= deadline:
            raise TargetError(f"waited {deadline_s:g} s for {what}")
        time.sleep(POLL_S)
