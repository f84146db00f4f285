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
from rtfiles.errors import UsageError
from rtrun.target.errors import TargetError
from rtrun.target.link import Link

FILE = "attempt.json"
LIMIT_BYTES = 16 * 1024 * 1024
# Not head -c: the busybox of a Yocto image need not have it.
_LEFT = """
cd "$1" 2>/dev/null || exit 0
[ -e given_up ] && echo given_up
for file in *.boot_id; do
    [ -e "$file" ] && echo "started ${file%.boot_id} $(cat "$file")"
done
echo attempt
[ -e attempt.json ] && [ "$(wc -c <attempt.json)" -le "$2" ] && cat attempt.json
exit 0
"""
# Of all other runs: a lock is held as long as something of a run lives.
_BUSY = """
for lock in "$1"/*/*/*.lock; do
    case $lock in "$2"/*) continue;; esac
    [ -e "$lock" ] || continue
    flock -n -s "$lock" true || { echo "${lock%.lock}"; break; }
done
exit 0
"""
# What comes in ends early when the link does: half of it gets no name.
_KEEP = """
mkdir -p "$1" && cd "$1" && cat >attempt.new && [ "$(wc -c <attempt.new)" -eq "$2" ] || exit 1
sync attempt.new && mv attempt.new attempt.json
"""


class Attempt(Config):
    """How a run began: when, with which ROS master, the target's state, each program's command line."""

    schema_number: Literal[1] = Field(alias="schema")
    uid: str
    start_time: str
    master_pid: int
    own_master: bool
    argv: dict[str, list[str]]
    before: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """What an earlier call left in a run's folder: the programs it started, `cut_off` if that was before a restart.

    `attempt` is known of what was started since.
    """

    attempt: Attempt | None
    started: frozenset[str]
    cut_off: bool
    given_up: bool


def left(link: Link, remote: PurePosixPath) -> Left:
    """Look at what an earlier call left of a run."""
    command = ["sh", "-c", _LEFT, "sh", str(remote), str(LIMIT_BYTES)]
    said, _, text = link.check(command).partition("attempt\n")
    words = [line.split() for line in said.splitlines()]
    boots = {word[1]: word[2] for word in words if len(word) == 3}
    cut_off = not set(boots.values()) <= {link.boot_id}
    return Left(
        attempt=_read(link, remote, text) if boots and text and not cut_off else None,
        started=frozenset(boots),
        cut_off=cut_off,
        given_up=["given_up"] in words,
    )


def _read(link: Link, remote: PurePosixPath, text: str) -> Attempt:
    origin = f"{link.target.address}: {remote / FILE}"
    try:
        return parse(json.loads(text), Attempt, origin)
    except (ValueError, UsageError) as error:
        raise TargetError(
            f"{origin}: not what rtrun wrote there; end what runs and remove the folder: {error}"
        ) from error


def folders(link: Link, runs: PurePosixPath) -> list[str]:
    """Return the names of the runs of a campaign that an earlier call has left something of."""
    command = ["sh", "-c", 'ls "$1" 2>/dev/null; exit 0', "sh", str(runs)]
    return link.check(command).splitlines()


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

    Raises TargetError when something of another run still lives on the target: both would be disturbed.
    """
    command = ["sh", "-c", _BUSY, "sh", str(remote.parent.parent), str(remote)]
    if busy := link.check(command).strip():
        raise TargetError(
            f"{link.target.address}: another run is still going on: {busy}; "
            f"take its campaign up again, or end it there: kill -- -$(cat {busy}.pid)"
        )
    data = {
        "schema": 1,
        "uid": secrets.token_hex(8),
        "start_time": start_time,
        "master_pid": master_pid,
        "own_master": own_master,
        "argv": {name: list(words) for name, words in argv.items()},
        "before": before,
    }
    text = json.dumps(data)
    keep = ["sh", "-c", _KEEP, "sh", str(remote), str(len(text.encode()))]
    link.check(keep, stdin=text)
    return parse(data, Attempt, FILE)
