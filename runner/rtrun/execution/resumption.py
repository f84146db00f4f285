"""What an earlier call left of a run on the target, and the attempt file that is needed to resume it.

The attempt file holds what the runner knew when the run began. A run may be resumed days later, with another build
of the suites at hand: the file names what really runs.
"""

import json
import secrets
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Annotated, Literal

from pydantic import Field

from rtfiles.config import Config, parse
from rtfiles.errors import UsageError
from rtfiles.untrusted import parse_json
from rtrun.results.record import Moment, RunRecord
from rtrun.targets import groups
from rtrun.targets.connection import COMMAND_S
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.facts import TargetState, parse_state
from rtrun.targets.link import Link

FILE = "attempt.json"
LIMIT_BYTES = 4 * 1024 * 1024  #: the attempt file of a run
# Not head -c: the busybox of a Yocto image need not have it.
_INSPECT = """
cd "$1" 2>/dev/null || exit 0
bytes_max=$2
shift 2
[ -e given_up ] && echo given_up
for name; do
    [ -e "$name.boot_id" ] && echo "started $name $(head -n 1 "$name.boot_id")"
done
echo attempt
for file in attempt.json state; do
    [ -e "$file" ] && [ "$(wc -c <"$file")" -le "$bytes_max" ] && cat "$file"
    echo
done
"""
# Prints the first living program of any run or build, and its process group if that is known.
_BUSY = (
    groups.FUNCTIONS
    + """
busy=$({ living "$1"; living "${1%/*}/building"; } | head -n 1)
if [ "$busy" ]; then
    name=${busy%.lock}
    cd "${busy%/*}" && find_group "${name##*/}" || group=
    echo "$name"
    echo "$group"
    exit 0
fi
"""
)
# Reads the names of the runs from standard input, one a line: others may have put a million folders next to them.
_FOLDERS = """
cd "$1" 2>/dev/null || exit 0
while IFS= read -r name; do [ -e "$name" ] && echo "$name"; done
exit 0
"""
# Prints the first run that may go on. A file kept by _KEEP_END of processes.py shows that a suite's programs ended.
_GOING_ON = """
cd "$1" 2>/dev/null || exit 0
while IFS= read -r name; do
    { [ ! -d "$name" ] || [ -e "$name/given_up" ] || [ -e "$name/ended_early" ]; } && continue
    find "$name/." ! -name . -prune -name '*.boot_id' -exec cat {} + |
        grep -qxFf /proc/sys/kernel/random/boot_id && echo "$name" && exit
done
exit 0
"""
# Makes the folder, prints the target's state. A lost link ends the input early: an incomplete file does not get its
# final name.
_WRITE = """
mkdir -p "$2" && cd "$2" && cat >attempt.new && [ "$(wc -c <attempt.new)" -eq "$3" ] || exit 1
sync attempt.new && mv attempt.new attempt.json && echo state && sh "$4" >state && cat state
"""


class Attempt(Config):
    """How a run began: when, with which service, the command line of each of its programs, and the target's state.

    The state is in a file of its own, which the target writes.
    """

    schema_number: Literal[1] = Field(alias="schema")
    uid: Annotated[str, Field(min_length=1, max_length=64)]
    start_time: Moment
    service: Annotated[str, Field(max_length=64)]
    """The identity of the service that its middleware needs; empty: it needs none."""
    own_service: bool
    argv: dict[str, list[str]]
    before: TargetState = Field(default_factory=TargetState)


@dataclass(frozen=True, slots=True, kw_only=True)
class Leftovers:
    """What an earlier call left in a run's folder on the target."""

    has_folder: bool
    started: frozenset[str]
    """The programs that it started."""
    cut_off: bool
    """Whether the target was restarted since."""
    given_up: bool
    attempt: Attempt | None
    """What is known of the programs that were started since the last restart."""
    unreadable: str | None
    """Why the attempt file, if there is one, could not be read."""

    def can_be_picked_up(self, measuring: Collection[str], closed: RunRecord | None) -> bool:
        """Whether the run is measuring, or has measured and has not been closed since.

        `measuring` are the programs that are started last: before them nothing is measured. `closed` is the record in
        the run directory. It may be of this very attempt, if the runner had no time to remove the folder on the target.
        """
        return (
            self.attempt is not None
            and not self.given_up
            and not self.started.isdisjoint(measuring)
            and not (closed and closed.attempt == self.attempt.uid)
        )


def inspect_leftovers(
    link: Link, remote: PurePosixPath, programs: Collection[str], others: Collection[str]
) -> Leftovers:
    """Inspect what an earlier call left of a run that has these programs of its suite, and these others."""
    command = ["sh", "-c", _INSPECT, "sh", str(remote), str(LIMIT_BYTES), *programs, *others]
    head, mark, text = link.check(command).partition("attempt\n")
    words = [line.split() for line in head.splitlines()]
    boots = {word[1]: word[2] for word in words if len(word) == 3}
    cut_off = not set(boots.values()) <= {link.boot_id}
    attempt, unreadable = None, None
    text, _, state = text.partition("\n")
    if boots and text and not cut_off:
        try:
            attempt = _parse_attempt(text, f"{link.target.address}: {remote / FILE}", programs)
            attempt = attempt.model_copy(update={"before": parse_state(state)})
        except UsageError as error:
            unreadable = str(error).splitlines()[0]
    return Leftovers(
        has_folder=bool(mark),
        started=frozenset(boots),
        cut_off=cut_off,
        given_up=["given_up"] in words,
        attempt=attempt,
        unreadable=unreadable,
    )


def _parse_attempt(text: str, origin: str, programs: Collection[str]) -> Attempt:
    attempt = parse(parse_json(text, origin), Attempt, origin)
    if missing := set(programs) - set(attempt.argv):
        raise UsageError(f"{origin}: argv: no command line of {', '.join(sorted(missing))}")
    return attempt


def list_folders(link: Link, runs: PurePosixPath, names: Collection[str]) -> list[str]:
    """Return those of these runs that still have a folder from an earlier call."""
    found = set(link.check(["sh", "-c", _FOLDERS, "sh", str(runs)], stdin=_lines(names)).splitlines())
    return [name for name in names if name in found]


def may_run_go_on(link: Link, runs: PurePosixPath, names: Collection[str]) -> bool:
    """Whether one of these runs may still be running: it was started on this boot, and its end was not seen.

    Ask this before ending anything that runs need. An error cannot tell it: the link may have broken before, while or
    after a run was started, and an earlier call may have left one.
    """
    return bool(link.check(["sh", "-c", _GOING_ON, "sh", str(runs)], stdin=_lines(names)).strip())


def _lines(names: Collection[str]) -> str:
    return "".join(f"{name}\n" for name in names)


def is_busy(link: Link) -> bool:
    """Whether a program of any run, or of a build of suites, lives on the target."""
    return bool(_find_busy(link))


def check_idle(link: Link) -> None:
    """Raise TargetError when a program of any run, or of a build of suites, still lives on the target."""
    _refuse_busy(link, _find_busy(link))


def _find_busy(link: Link) -> str:
    return link.check(["sh", "-c", _BUSY, "sh", str(link.target.work_dir / "runs")])


def _refuse_busy(link: Link, printed: str) -> None:
    """Raise TargetError when `_BUSY` printed a program."""
    if busy := printed.splitlines():
        how = f": kill -- -{busy[1]}" if busy[1:] and busy[1].isdecimal() else ""
        is_run = "/runs/" in busy[0]
        what, goes_on = ("another run", "resume its campaign") if is_run else ("a build of suites", "wait for it")
        raise TargetError(
            f"{link.target.address}: {what} is still going on: {busy[0]}; {goes_on}, or end it there{how}"
        )


def without_folder(start_time: str, before: TargetState) -> Attempt:
    """The attempt at a run that leaves nothing on the target, so no later call can resume it."""
    return Attempt(
        schema=1, uid=secrets.token_hex(8), start_time=start_time, service="", own_service=False, argv={}, before=before
    )


def begin(
    link: Link,
    remote: PurePosixPath,
    *,
    start_time: str,
    service: str,
    own_service: bool,
    argv: Mapping[str, Sequence[str]],
    state_script: PurePosixPath,
) -> Attempt:
    """Make the folder of a run with its attempt file and the target's state, which a script there prints.

    Raises TargetError when a program of another run, or a build, still lives on the target: each would disturb the
    other.
    """
    data = {
        "schema": 1,
        "uid": secrets.token_hex(8),
        "start_time": start_time,
        "service": service,
        "own_service": own_service,
        "argv": {name: list(words) for name, words in argv.items()},
    }
    text = json.dumps(data)
    words = [str(remote.parent.parent), str(remote), str(len(text.encode())), str(state_script)]
    command = ["sh", "-c", _BUSY + _WRITE, "sh", *words]
    # This command does the work of two.
    printed = link.check(command, deadline_s=2 * COMMAND_S, stdin=text)
    busy, _, state = printed.partition("state\n")
    _refuse_busy(link, busy)
    return parse(data, Attempt, FILE).model_copy(update={"before": parse_state(state)})
