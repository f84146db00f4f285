"""Programs on the target, detached from the connection: started once, waited for, ended."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import overload

from rtfiles.untrusted import whole_number
from rtrun.plan.program import Exit, Program
from rtrun.targets import groups
from rtrun.targets.connection import join_commands
from rtrun.targets.errors import DeadlineExpired, TargetError
from rtrun.targets.link import Link

# The longest single wait: between two waits the runner looks whether the target still exists.
WAIT_S = 15.0
# The shortest single wait: opening a channel takes time on a slow link.
SLICE_S = 2.0
POLL_S = 0.1
# Programs that ignore SIGTERM are killed one after the other, two seconds each.
END_BACKGROUND_S = 120.0
# To remove a folder with some million files from an SD card.
REMOVE_S = 600.0

# Before it waits it looks whether one of the programs that this one works for, $3 and so on, has failed meanwhile.
_WAIT = """
cd "$1" || exit 1
program=$2
shift 2
for name; do
    flock -n -s "$program.lock" true && break
    flock -n -s "$name.lock" true || continue
    status=
    [ ! -e "$name.exit" ] || read -r status _ <"$name.exit"
    [ "$status" = 0 ] || { echo "failed $name"; exit 0; }
done
flock -s "$program.lock" true
cat "$program.exit" 2>/dev/null
[ -e "$program.expired" ] && echo expired
exit 0
"""
_LIST_ENDED = 'cd "$1" && shift && for name; do if flock -n -s "$name.lock" true; then echo "$name"; fi; done'
# Programs, with the name * all that live, are asked to end (SIGTERM), and killed when their time is up: $2, pauses in
# seconds.
_END = (
    groups.OF_PROGRAM
    + groups.LIVING
    + """
cd "$1" 2>/dev/null || exit 0
pauses=$2
shift 2
if [ "$*" = "*" ]; then
    # Their names have no blanks.
    # shellcheck disable=SC2046
    set -- $(living . | sed 's,.*/,,; s,[.]lock$,,')
fi
boot_id=$(cat /proc/sys/kernel/random/boot_id)
running=
status=0
for name; do
    # The lock is taken before the program starts: while it is taken, the pid file is still to come.
    for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
        [ -s "$name.pid" ] && break
        flock -n "$name.lock" true && continue 2
        sleep 0.2
    done
    # After a reboot the pid belongs to another process.
    [ "$(cat "$name.boot_id" 2>/dev/null)" = "$boot_id" ] || continue
    if find_group; then
        kill -TERM "-$group" 2>/dev/null && running="$running $name"
    elif ! flock -n "$name.lock" true; then
        echo "$PWD/$name runs, but its pid file does not say which process it is: end it on the target" >&2
        status=1
    fi
done
for name in $running; do
    for pause in $pauses; do flock -n "$name.lock" true && continue 2; sleep $pause; done
    find_group && kill -KILL "-$group" 2>/dev/null
    for _ in 1 2 3 4 5 6 7 8 9 10; do flock -n "$name.lock" true && break; sleep 0.1; done
done
exit $status
"""
)
# For a program that puts something right at its end.
_LONG_PAUSES_S = "0.05 0.05 0.1 0.2 0.2 0.2 0.4 0.4 0.4"
# For a load, which has nothing to put right: a worker of stress-ng --vm ends only after its pass over the memory.
_SHORT_PAUSES_S = "0.05 0.05 0.1"
# supervise.sh starts nothing in a folder with this mark, not even when it was called before the mark was made.
_GIVE_UP = '[ ! -d "$1" ] || : >"$1/given_up"; exit 0'
_MARK = "== ended"
# A background program ended early when it ended before the last of the suite's programs. This answer and the service
# that was seen at the end are kept in the folder before anything is ended: the caller may ask again after a lost link,
# or after the runner was killed, and then what the runner itself has ended must not count.
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
    """What the end of a run found.

    `early` are the background programs that ended before the suite did, name to exit status, which is empty where there
    is none. `service` is the identity of that of the middleware when the suite had ended, as it was first seen.
    """

    early: Mapping[str, str]
    service: str
    output: str
    """Of the commands that followed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NeededFailed:
    """A program that another one works for has failed; `name` says which."""

    name: str


def start(
    link: Link, scripts: PurePosixPath, folder: PurePosixPath, *programs: Program, setup: str | None = None
) -> None:
    """Start programs in this order in an existing folder of the target; a program is started there only once."""
    commands = []
    for program in programs:
        env = ["env", *(f"{name}={value}" for name, value in program.environment)] if program.environment else []
        deadline = str(round(program.deadline_s))
        supervise = str(scripts / "supervise.sh")
        commands.append([supervise, str(folder), program.name, deadline, setup or "", *env, *program.argv])
    link.check(join_commands(commands))


@overload
def wait(link: Link, folder: PurePosixPath, name: str, *, deadline_s: float) -> Exit: ...
@overload
def wait(
    link: Link, folder: PurePosixPath, name: str, *, deadline_s: float, needed: Sequence[str]
) -> Exit | NeededFailed: ...
def wait(
    link: Link, folder: PurePosixPath, name: str, *, deadline_s: float, needed: Sequence[str] = ()
) -> Exit | NeededFailed:
    """Wait for the end of a program, or until one of the `needed` programs has failed: seen WAIT_S later at most.

    The wait blocks on a file lock, so it costs the target no CPU time. Raises DeadlineExpired when the program has not
    ended in time, TargetGone and TargetRebooted.
    """
    deadline = time.monotonic() + deadline_s
    command = ["sh", "-c", _WAIT, "sh", str(folder), name, *needed]
    while True:
        slice_s = min(WAIT_S, max(SLICE_S, deadline - time.monotonic()))
        try:
            words = link.check(command, deadline_s=slice_s).split()
        except DeadlineExpired:
            if failure := link.target.failure():
                raise failure from None
            if time.monotonic() >= deadline:
                raise
            continue
        if words[:1] == ["failed"] and words[1:] and words[1] in needed:
            return NeededFailed(name=words[1])
        return Exit(status=_exit_status(words[0]) if words else None, expired="expired" in words)


def _exit_status(word: str) -> int | None:
    """Read what supervise.sh wrote; None where it wrote no exit status."""
    try:
        return whole_number(word, lowest=0, highest=255)
    except ValueError:
        return None


def end(link: Link, folder: PurePosixPath, *names: str) -> None:
    """End those programs of a folder that still run, with everything they started."""
    link.run(_end(folder, names), deadline_s=END_BACKGROUND_S)


def remove(link: Link, folder: PurePosixPath) -> None:
    """Remove a folder of the target in which nothing runs, whatever is in it."""
    link.check(["rm", "-rf", str(folder)], deadline_s=REMOVE_S)


def give_up(link: Link, folder: PurePosixPath, names: Sequence[str] = ("*",)) -> None:
    """End these programs of a folder, or all; prevent pending starts, and remove the folder.

    May be repeated after a failure.
    """
    commands = [["sh", "-c", _GIVE_UP, "sh", str(folder)], _end(folder, names), ["rm", "-rf", str(folder)]]
    link.check(join_commands(commands), deadline_s=END_BACKGROUND_S + REMOVE_S)


def _end(folder: PurePosixPath, names: Sequence[str], pauses: str = _LONG_PAUSES_S) -> list[str]:
    return ["sh", "-c", _END, "sh", str(folder), pauses, *names]


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

    The `loads` are killed soon, the `others` get time to put right what they changed; those that stand in `first`, too,
    are ended before the loads. `service` is the identity of that of the middleware now. Where no programs of a suite
    measure, whatever has ended by itself has ended early.
    """
    keep_end = ["sh", "-c", _KEEP_END, "sh", str(folder), service, " ".join(programs), *loads, *others]
    commands = [
        keep_end,
        ["echo", _MARK],
        _end(folder, first),
        _end(folder, loads, _SHORT_PAUSES_S),
        _end(folder, others),
        *then,
    ]
    output = link.check(join_commands(commands), deadline_s=END_BACKGROUND_S)
    kept, _, rest = output.partition(f"{_MARK}\n")
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
