"""Programs on the target, detached from the connection: started once, waited for, ended."""

import contextlib
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import overload

from rtfiles.output import listed
from rtfiles.untrusted import whole_number
from rtrun.kinds.limits import PID_MAX
from rtrun.plan.program import Exit, Program
from rtrun.targets import groups
from rtrun.targets.connection import join_commands
from rtrun.targets.errors import DeadlineExpired, TargetError
from rtrun.targets.link import Link

# The longest single wait: between two waits the runner checks whether the target still exists.
WAIT_S = 15.0
# The shortest single wait: opening a channel takes time on a slow link.
SLICE_S = 2.0
POLL_S = 0.1
# Programs that ignore SIGTERM are killed one after the other, two seconds each.
END_BACKGROUND_S = 300.0  #: ending the programs of a run
# To remove a folder with some million files from an SD card.
REMOVE_S = 600.0  #: removing a folder from the target

# A process of the target is forked as often, to sleep.
FOLLOW_S = 2

# Waits for the program $2. First it checks whether one of the programs that it needs, those of $3, has failed.
# Meanwhile it prints the lines of the files $5 and so on, every $4 seconds.
_WAIT = """
cd "$1" || exit 1
program=$2 needed=$3 pause_s=$4
shift 4
for name in $needed; do
    flock -n -s "$program.lock" true && break
    flock -n -s "$name.lock" true || continue
    status=
    [ ! -e "$name.exit" ] || read -r status _ <"$name.exit"
    [ "$status" = 0 ] || { echo "failed $name"; exit 0; }
done
[ $# = 0 ] || {
    while sleep "$pause_s" </dev/null >/dev/null; do
        for name; do
            line=
            [ ! -e "$name" ] || read -r line <"$name"
            [ -z "$line" ] || echo "line $name $line"
        done
    done 2>/dev/null &
    follower=$!
}
flock -s "$program.lock" true
[ $# = 0 ] || { kill $follower; wait $follower; } 2>/dev/null
cat "$program.exit" 2>/dev/null
[ -e "$program.expired" ] && echo expired
exit 0
"""
_LIST_ENDED = 'cd "$1" && shift && for name; do if flock -n -s "$name.lock" true; then echo "$name"; fi; done'
# Ends programs by the signals of $2, as `end_processes` reads them; the name * stands for all of the folder. Prints a
# line "PROGRAM PID NAME" for each process that stays, without the last two words if the target does not show them.
_END = (
    groups.FUNCTIONS
    + """
cd "$1" 2>/dev/null || exit 0
stages=$2
shift 2
if [ "$*" = "*" ]; then
    # Their names have no blanks.
    # shellcheck disable=SC2046
    set -- $(find . ! -name . -prune -name '*.known_by' | sed 's,^[.]/,,; s,[.]known_by$,,')
fi
names=$*
lives() { [ -e "$name.lock" ] && ! flock -n "$name.lock" true; }
all() { for name in $names; do know "$name" && "$@"; done; }
# The lock is taken before the program starts: while it is taken, what it is known by is still to come.
for name in $names; do
    for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
        lives && ! { know "$name" && [ -n "$(list_processes)" ]; } || break
        sleep 0.2
    done
done
end_processes "$stages" all >/dev/null
for name in $names; do
    know "$name"
    remove_group
    for _ in 1 2 3 4 5 6 7 8 9 10; do lives || break; sleep 0.1; done
    left=$(list_processes)
    ! lives || left=$({ echo "$left"; list_holders; } | sort -u)
    if [ -n "$left" ]; then
        name_processes $left | while IFS= read -r line; do echo "$name $line"; done
    elif lives; then
        echo "$name"
    fi
done
exit 0
"""
)
# For a program that restores something at its end.
_PATIENT = "TERM:20 KILL:10"
# For a load, which has nothing to restore: a worker of stress-ng --vm ends only after its pass over the memory.
_IMPATIENT = "TERM:2 KILL:10"
LIKE_CTRL_C = "INT:100 TERM:50 KILL:20"
"""For a driver that stops its motors: first the signal of Ctrl-C."""
_LEFT_SHOWN = 8
_LEFT = re.compile(r"([A-Za-z0-9_.-]{1,64})(?: ([0-9]{1,7}) ([ -~]{0,64}))?", re.ASCII)
# Prints the state of a program's command: exit status, whether its supervisor lives, the processes that it started.
_LOOK = (
    groups.FUNCTIONS
    + """
cd "$1" && know "$2" || exit 1
status=
flock -n -s "$2.supervised" true && echo alone
[ ! -e "$2.exit" ] || read -r status _ <"$2.exit"
[ -z "$status" ] || echo "exit $status"
list_processes | sed 's/:.*//; s/^/process /'
exit 0
"""
)
# supervise.sh starts nothing in a folder with this mark, not even when it was called before the mark was made.
_GIVE_UP = '[ ! -d "$1" ] || : >"$1/given_up"; exit 0'
_MARK = "== ended"
_THEN = "== then"
# A background program ended early if it ended before the last of the suite's programs. This answer and the service seen
# at the end are kept in the folder before anything is ended. The caller may ask again after a lost link, or after the
# runner was killed; then programs that the runner itself has ended must not count.
_KEEP_END = """
cd "$1" || exit 1
# Of two callers that write at the same time the first wins. On a full disk the new word is used, and not kept.
write_if_absent() {
    echo "$2" >"$1.$$" && ln "$1.$$" "$1" 2>/dev/null
    cat "$1" || echo "$2"
}
write_if_absent service "$2"
suite=$3
shift 3
# In hundredths of a second since the boot: the wall clock may have been set meanwhile.
end_of() {
    uptime=0.00
    [ ! -e "$1.exit" ] || read -r _ uptime <"$1.exit"
    echo "${uptime%.*}${uptime#*.}"
}
early=$(for name; do
    flock -n -s "$name.lock" true || continue
    # The programs of a suite measure; without any it is early in any case.
    for program in ${suite:-none}; do
        [ "$suite" ] && [ "$(end_of "$name")" -ge "$(end_of "$program")" ] && continue
        status=
        [ ! -e "$name.exit" ] || read -r status _ <"$name.exit"
        echo "$name $status"
        break
    done
done)
write_if_absent ended_early "$early"
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """What was found when a run was ended.

    `early` are the background programs that ended before the suite, name to exit status; empty: there is no status.
    `service` is the identity of the middleware's service when the suite had ended, as it was first seen.
    """

    early: Mapping[str, str]
    service: str
    output: str
    """The output of the commands that followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Following:
    """Files of one line in the folder of a program that is waited for: every FOLLOW_S each line goes to `take`.

    `take` gets the name of the file and its line, which is unchecked.
    """

    files: Sequence[str]
    take: Callable[[str, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class NeededFailed:
    """A program that the awaited one needs has failed; `name` says which."""

    name: str


def start(
    link: Link, scripts: PurePosixPath, folder: PurePosixPath, *programs: Program, setup: str | None = None
) -> None:
    """Start programs in this order in an existing folder of the target; a program is started there only once."""
    link.check(join_commands([call(scripts, folder, program, setup=setup) for program in programs]))


def call(scripts: PurePosixPath, folder: PurePosixPath, program: Program, *, setup: str | None = None) -> list[str]:
    """The command that starts a program in an existing folder of the target."""
    env = ["env", *(f"{name}={value}" for name, value in program.environment)] if program.environment else []
    deadline = str(round(program.deadline_s))
    supervise = str(scripts / "supervise.sh")
    return [supervise, str(folder), program.name, deadline, setup or "", *env, *program.argv]


@overload
def wait(link: Link, folder: PurePosixPath, name: str, *, deadline_s: float) -> Exit: ...
@overload
def wait(
    link: Link,
    folder: PurePosixPath,
    name: str,
    *,
    deadline_s: float,
    needed: Sequence[str],
    following: Following | None = None,
) -> Exit | NeededFailed: ...
def wait(
    link: Link,
    folder: PurePosixPath,
    name: str,
    *,
    deadline_s: float,
    needed: Sequence[str] = (),
    following: Following | None = None,
) -> Exit | NeededFailed:
    """Wait for the end of a program, or until one of the `needed` programs has failed, which is seen within WAIT_S.

    The wait blocks on a file lock, so it costs the target no CPU time unless files are followed. Raises
    DeadlineExpired when the program has not ended in time, TargetGone and TargetRebooted.
    """
    deadline = time.monotonic() + deadline_s
    files = following.files if following else ()
    command = ["sh", "-c", _WAIT, "sh", str(folder), name, " ".join(needed), str(FOLLOW_S), *files]

    def take(line: str) -> None:
        word, _, rest = line.partition(" ")
        file, _, content = rest.partition(" ")
        if following and word == "line" and file in files:
            following.take(file, content)

    while True:
        slice_s = min(WAIT_S, max(SLICE_S, deadline - time.monotonic()))
        try:
            printed = link.check(command, deadline_s=slice_s, on_line=take if following else None)
        except DeadlineExpired:
            if failure := link.target.failure():
                raise failure from None
            if time.monotonic() >= deadline:
                raise
            continue
        words = [word for line in printed.splitlines() if not line.startswith("line ") for word in line.split()]
        if words[:1] == ["failed"] and words[1:] and words[1] in needed:
            return NeededFailed(name=words[1])
        return Exit(status=_exit_status(words[0]) if words else None, expired="expired" in words)


def _exit_status(word: str) -> int | None:
    """Read what supervise.sh wrote; None where it wrote no exit status."""
    try:
        return whole_number(word, lowest=0, highest=255)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Supervision:
    """The state of a started program: the exit status of its command, once it has ended, and its living processes.

    `is_alone`: its supervisor has ended. If there is no exit status, the supervisor was killed from outside.
    """

    status: int | None
    is_alone: bool
    pids: frozenset[int]


def look(link: Link, folder: PurePosixPath, name: str) -> Supervision:
    """Read the state of a started program without waiting for it."""
    words = [line.split() for line in link.check(["sh", "-c", _LOOK, "sh", str(folder), name]).splitlines()]
    pids = set()
    for word in (word for word in words if word[:1] == ["process"] and len(word) == 2):
        with contextlib.suppress(ValueError):
            pids.add(whole_number(word[1], lowest=2, highest=PID_MAX))
    status = next((_exit_status(word[1]) for word in words if word[:1] == ["exit"] and len(word) == 2), None)
    return Supervision(status=status, is_alone=["alone"] in words, pids=frozenset(pids))


def end(link: Link, folder: PurePosixPath, *names: str, stages: str = _PATIENT) -> None:
    """End those of these programs that still run, with everything they started; a note names what stays."""
    printed = link.check(_end(folder, names, stages), deadline_s=END_BACKGROUND_S)
    if left := _left(printed):
        link.note(f"{link.target.address}: {left}")


def _left(printed: str) -> str:
    """The processes that stay according to `_END`, in words; empty: nothing stays."""
    lines = [match for line in printed.splitlines() if (match := _LEFT.fullmatch(line))]
    names = [f"{match[2]} ({match[3]}) of {match[1]}" if match[2] else f"hidden ones of {match[1]}" for match in lines]
    if not names:
        return ""
    return f"these processes could not be ended: {listed(names, _LEFT_SHOWN)}: end them on the target"


def remove(link: Link, folder: PurePosixPath) -> None:
    """Remove a folder of the target, whatever is in it, and end what its programs left; a note says what stays."""
    commands = [_end(folder, ["*"]), ["rm", "-rf", str(folder)]]
    printed = link.check(join_commands(commands), deadline_s=END_BACKGROUND_S + REMOVE_S)
    if left := _left(printed):
        link.note(f"{link.target.address}: {left}")


def give_up(link: Link, folder: PurePosixPath, names: Sequence[str] = ("*",)) -> None:
    """End these programs of a folder, or all; prevent pending starts, and remove the folder.

    May be repeated after a failure. Raises TargetError if some process cannot be ended.
    """
    commands = [["sh", "-c", _GIVE_UP, "sh", str(folder)], _end(folder, names)]
    if left := _left(link.check(join_commands(commands), deadline_s=END_BACKGROUND_S)):
        raise TargetError(f"{link.target.address}: {folder}: {left}")
    link.check(["rm", "-rf", str(folder)], deadline_s=REMOVE_S)


def _end(folder: PurePosixPath, names: Sequence[str], stages: str = _PATIENT) -> list[str]:
    return ["sh", "-c", _END, "sh", str(folder), stages, *names]


def end_background(
    link: Link,
    folder: PurePosixPath,
    programs: Sequence[str],
    loads: Sequence[str],
    others: Sequence[str],
    *,
    service: str,
    then: Sequence[Sequence[str]],
    first: Sequence[str] = (),
) -> Ended:
    """End the background programs of a suite whose `programs` have ended, then run the commands `then`.

    The `loads` are killed soon, the `others` get time to restore what they changed. Those that are also in `first` are
    ended before the loads. `service` is the present identity of the middleware's service. If no programs of a suite
    measure, every background program that has ended on its own has ended early.
    """
    keep_end = ["sh", "-c", _KEEP_END, "sh", str(folder), service, " ".join(programs), *loads, *others]
    commands = [
        keep_end,
        ["echo", _MARK],
        _end(folder, first),
        _end(folder, loads, _IMPATIENT),
        _end(folder, others),
        ["echo", _THEN],
        *then,
    ]
    output = link.check(join_commands(commands), deadline_s=END_BACKGROUND_S)
    kept, _, rest = output.partition(f"{_MARK}\n")
    printed, _, rest = rest.partition(f"{_THEN}\n")
    if left := _left(printed):
        link.note(f"{link.target.address}: {left}")
    service, *early = kept.split("\n")
    return Ended(
        early={name: status for name, _, status in (line.partition(" ") for line in early if line)},
        service=service.strip(),
        output=rest,
    )


def read_last_line(link: Link, path: PurePosixPath) -> str:
    """Return the last line of a file on the target, at most 500 characters; empty without such a file."""
    result = link.run(["tail", "-n", "1", str(path)])
    return result.stdout.strip()[:500]


def list_ended(link: Link, folder: PurePosixPath, names: Sequence[str]) -> list[str]:
    """Return which of these started programs have ended."""
    command = ["sh", "-c", _LIST_ENDED, "sh", str(folder), *names]
    return link.check(command).split()


def wait_until(condition: Callable[[], bool], *, deadline_s: float, what: str) -> None:
    """Poll until a condition is true. Raises TargetError ``waited … s for <what>``."""
    deadline = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() >= deadline:
            raise TargetError(f"waited {deadline_s:g} s for {what}")
        time.sleep(POLL_S)
