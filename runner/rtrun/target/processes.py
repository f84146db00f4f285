"""One program on the target, detached: started once, waited for, ended, whatever happens to the connection."""

import time
from collections.abc import Callable, Sequence
from pathlib import PurePosixPath

from rtrun.plan.program import Exit, Program
from rtrun.target.errors import DeadlineExpired, TargetError
from rtrun.target.link import Link
from rtrun.target.ssh import in_turn

# One wait lasts at most this long, so that a board that died is noticed while we wait.
WAIT_S = 15.0
# And not less: to open a channel takes its time on a slow link.
SLICE_S = 2.0
POLL_S = 0.1
# Loads that will not end by themselves are killed one after the other, two seconds each.
END_BESIDE_S = 120.0

_WAIT = 'flock -s "$1.lock" true; cat "$1.exit" 2>/dev/null; [ -e "$1.expired" ] && echo expired; exit 0'
_ENDED = 'cd "$1" && shift && for name; do if flock -n -s "$name.lock" true; then echo "$name"; fi; done'
_END = """
cd "$1" 2>/dev/null && shift || exit 0
boot_id=$(cat /proc/sys/kernel/random/boot_id)
running=
for name; do
    # Its lock is held from before its start: a pid that is not there yet will come.
    for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
        [ -s "$name.pid" ] && break
        flock -n "$name.lock" true && continue 2
        sleep 0.2
    done
    # A pid of another boot is some other process now.
    [ "$(cat "$name.boot_id" 2>/dev/null)" = "$boot_id" ] || continue
    [ -s "$name.pid" ] && kill -TERM "-$(cat "$name.pid")" 2>/dev/null && running="$running $name"
done
for name in $running; do
    for pause in 0.05 0.05 0.1 0.2 0.2 0.2 0.4 0.4 0.4; do flock -n "$name.lock" true && continue 2; sleep $pause; done
    kill -KILL "-$(cat "$name.pid")" 2>/dev/null
    for _ in 1 2 3 4 5 6 7 8 9 10; do flock -n "$name.lock" true && break; sleep 0.1; done
done
exit 0
"""
# supervise.sh starts nothing in a folder that was given up: a start that is still under way comes too late.
_GIVE_UP = '[ ! -d "$1" ] || : >"$1/given_up"; exit 0'
_MARK = "== ended"
# Of two that write at once the first is right; on a full disk what we found must do.
_ONCE = """
cd "$1" || exit 1
once() {
    [ -e "$1" ] || { echo "$2" >"$1.$$" && ln "$1.$$" "$1"; }
    cat "$1" || echo "$2"
}
"""
# Ended before one of the suite's programs did: after all of their ends is only what outlived the suite.
# Written down once, before we end anything: whoever asks again, after a lost link or for a runner that was killed,
# must not take for dead what we ended.
_DIED = (
    _ONCE
    + """suite=$2
shift 2
# In hundredths of a second since the boot: the clock on the wall may have been set meanwhile.
end_of() {
    uptime=0.00
    [ ! -e "$1.exit" ] || read -r _ uptime <"$1.exit"
    echo "${uptime%.*}${uptime#*.}"
}
found=$(for name; do
    flock -n -s "$name.lock" true || continue
    for program in $suite; do
        [ "$(end_of "$name")" -ge "$(end_of "$program")" ] && continue
        status=
        [ ! -e "$name.exit" ] || read -r status _ <"$name.exit"
        echo "$name $status"
        break
    done
done)
once died "$found"
"""
)


def start(
    link: Link, scripts: PurePosixPath, folder: PurePosixPath, *programs: Program, setup: str | None = None
) -> None:
    """Start programs in a folder that is on the target, in this order; one started there already is not."""
    commands = []
    for program in programs:
        env = ["env", *(f"{name}={value}" for name, value in program.environment)] if program.environment else []
        deadline = str(max(1, round(program.deadline_s)))
        supervise = str(scripts / "supervise.sh")
        commands.append([supervise, str(folder), program.name, deadline, setup or "", *env, *program.argv])
    link.check(in_turn(commands))


def wait(link: Link, folder: PurePosixPath, name: str, *, deadline_s: float) -> Exit:
    """Wait for the end of a program; the target spends nothing on it meanwhile.

    Raises DeadlineExpired when it has not ended in time, TargetGone and TargetRebooted.
    """
    deadline = time.monotonic() + deadline_s
    command = ["sh", "-c", _WAIT, "sh", str(folder / name)]
    while True:
        slice_s = min(WAIT_S, max(SLICE_S, deadline - time.monotonic()))
        try:
            said = link.check(command, deadline_s=slice_s).split()
        except DeadlineExpired:
            if failure := link.target.failure():
                raise failure from None
            if time.monotonic() >= deadline:
                raise
            continue
        status = int(said[0]) if said and said[0].isdigit() else None
        return Exit(status=status, expired="expired" in said)


def end(link: Link, folder: PurePosixPath, *names: str) -> None:
    """End programs of a folder and everything they started, as far as they still run."""
    link.run(_end(folder, names), deadline_s=END_BESIDE_S)


def give_up(link: Link, folder: PurePosixPath, names: Sequence[str]) -> None:
    """End programs of a folder, or those about to start there, and remove it; cut short, it may be called again."""
    commands = [["sh", "-c", _GIVE_UP, "sh", str(folder)], _end(folder, names), ["rm", "-rf", str(folder)]]
    link.check(in_turn(commands), deadline_s=END_BESIDE_S)


def _end(folder: PurePosixPath, names: Sequence[str]) -> list[str]:
    return ["sh", "-c", _END, "sh", str(folder), *names]


def end_beside(
    link: Link, folder: PurePosixPath, programs: Sequence[str], names: Sequence[str], then: Sequence[str]
) -> tuple[dict[str, str], str]:
    """End the programs `names` that ran beside `programs`, which have ended, and run the command `then`.

    Returns those that had ended before the others did, name to exit status or empty, and what the command printed.
    """
    died = ["sh", "-c", _DIED, "sh", str(folder), " ".join(programs), *names]
    commands = [died, ["echo", _MARK], _end(folder, names), then]
    said = link.check(in_turn(commands), deadline_s=END_BESIDE_S)
    deaths, _, rest = said.partition(f"{_MARK}\n")
    return {name: status for name, _, status in (line.partition(" ") for line in deaths.split("\n") if line)}, rest


def once(link: Link, folder: PurePosixPath, name: str, word: str) -> str:
    """Write a word down in a folder unless one stands there, and return the one that does."""
    command = ["sh", "-c", f'{_ONCE}once "$2" "$3"', "sh", str(folder), name, word]
    return link.check(command).strip()


def tail(link: Link, path: PurePosixPath) -> str:
    """Return the last line of a file on the target, for a message; empty when there is none."""
    result = link.run(["tail", "-n", "1", str(path)])
    return result.stdout.strip()[:500]


def ended(link: Link, folder: PurePosixPath, names: Sequence[str]) -> list[str]:
    """Return those of the programs, all started, that have ended."""
    command = ["sh", "-c", _ENDED, "sh", str(folder), *names]
    return link.check(command).split()


def until(condition: Callable[[], bool], *, deadline_s: float, what: str) -> None:
    """Ask until a condition holds. Raises TargetError ``waited … s for <what>``."""
    deadline = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() >= deadline:
            raise TargetError(f"waited {deadline_s:g} s for {what}")
        time.sleep(POLL_S)
