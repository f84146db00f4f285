"""One attempt at a run: what the runner knew when it began, kept in the run's folder on the target until it is closed.

Whoever picks the run up, days later and perhaps with other suites at hand, tells by it what really runs there.
"""

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Literal

from pydantic import Field

from rtfiles.config import Config, parse
from rtrun.errors import TargetError
from rtrun.link import Link

FILE = "attempt.json"
LIMIT_BYTES = 16 * 1024 * 1024
_LEFT = """
cd "$1" 2>/dev/null || exit 0
[ -e given_up ] && echo given_up
for file in *.boot_id; do
    [ -e "$file" ] && echo "started ${file%.boot_id} $(cat "$file")"
done
echo attempt
head -c "$2" attempt.json 2>/dev/null
exit 0
"""
# Of all other campaigns: a lock is held as long as something of a run lives.
_BUSY = """
for lock in "$1"/*/*/*.lock; do
    case $lock in "$2"/*) continue;; esac
    [ -e "$lock" ] || continue
    flock -n -s "$lock" true || { echo "${lock%.lock}"; break; }
done
exit 0
"""
_KEEP = 'mkdir -p "$1" && cat >"$1/attempt.new" && sync "$1/attempt.new" && mv "$1/attempt.new" "$1/attempt.json"'


class Attempt(Config):
    """How a run began: when, on which boot, with which ROS master, the target's state, each program's command line."""

    schema_number: Literal[1] = Field(alias="schema")
    uid: str
    boot_id: str
    start_time: str
    master_pid: int
    own_master: bool
    argv: dict[str, list[str]]
    before: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """What an earlier call left in a run's folder: `started` is program to the boot it was started in."""

    attempt: Attempt | None
    started: Mapping[str, str]
    given_up: bool


NOTHING_LEFT = Left(attempt=None, started={}, given_up=False)


def left(link: Link, remote: PurePosixPath) -> Left:
    """Look at what an earlier call left of a run."""
    command = ["sh", "-c", _LEFT, "sh", str(remote), str(LIMIT_BYTES)]
    said, _, text = link.do(lambda connection: connection.check(command)).partition("attempt\n")
    words = [line.split() for line in said.splitlines()]
    return Left(
        attempt=_read(link, remote, text) if text else None,
        started={word[1]: word[2] for word in words if len(word) == 3},
        given_up=["given_up"] in words,
    )


def _read(link: Link, remote: PurePosixPath, text: str) -> Attempt:
    origin = f"{link.target.address}: {remote / FILE}"
    try:
        return parse(json.loads(text), Attempt, origin)
    except ValueError as error:
        raise TargetError(f"{origin}: not what rtrun wrote there; remove the folder: {error}") from error


def begin(
    link: Link,
    remote: PurePosixPath,
    *,
    start_time: str,
    master_pid: int,
    own_master: bool,
    argv: Mapping[str, Sequence[str]],
    before: dict[str, Any],
) -> Attempt:
    """Make the folder of a run, and write down what it begins with.

    Raises TargetError when something of another campaign still runs on the target: both would be disturbed.
    """
    command = ["sh", "-c", _BUSY, "sh", str(remote.parent.parent), str(remote.parent)]
    if busy := link.do(lambda connection: connection.check(command)).strip():
        raise TargetError(
            f"{link.target.address}: a run of another campaign is still going on: {busy}; "
            f"take that campaign up again, or end it there: kill -- -$(cat {busy}.pid)"
        )
    data = {
        "schema": 1,
        "uid": secrets.token_hex(8),
        "boot_id": link.boot_id,
        "start_time": start_time,
        "master_pid": master_pid,
        "own_master": own_master,
        "argv": {name: list(words) for name, words in argv.items()},
        "before": before,
    }
    keep = ["sh", "-c", _KEEP, "sh", str(remote)]
    link.do(lambda connection: connection.check(keep, stdin=json.dumps(data)))
    return parse(data, Attempt, FILE)
