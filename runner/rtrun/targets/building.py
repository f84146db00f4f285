"""Build the suites on a target, with its own compiler and for its own ROS."""

import secrets
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from rtfiles.errors import UsageError
from rtrun.plan.program import Program
from rtrun.targets import deploy, groups, processes
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import OUT_OF_REACH, Link

NAME = "build"
# The folder of the suites in the target's work folder.
BUILT = "built"
SCRIPT = "build_suites.sh"
# A slow board with one CPU takes half an hour.
BUILD_S = 3 * 3600.0  # of our own build program
END_GRACE_S = 60.0  # of our own build program, to end what it has started
# How much of an error's output is shown.
SHOWN_LINES = 16
SHOWN_CHARACTERS = 8000
# The middlewares that a shell file sets up. The target may have several such files.
OF_ROS = ("roscpp", "rcl")
_LIVING_RUNS = groups.FUNCTIONS + 'cd "$1" && living runs'
# Starts a build in the folder $2 below $1 by the words that follow. If another build is going on, it prints that one's
# process group instead. A build holds the lock of all builds as long as one of its processes lives, also when its
# runner is gone. This may be repeated after a lost link: the build that it started is not refused.
_START = (
    groups.FUNCTIONS
    + """
mkdir -p "$1/$2" && cd "$1" || exit 1
folder=$2
shift 2
[ ! -e "$folder/build.boot_id" ] || exit 0
(umask 077 && : >>lock) && exec 7>lock || exit 1
if ! flock -n 7; then
    rm -rf "$folder"
    other=$(living . | head -n 1)
    cd "${other%/*}" 2>/dev/null && find_group build || group=
    echo "busy ${group:-unknown}"
    exit 0
fi
# Another runner may be about to read how its own has ended.
for other in */; do
    [ "$other" = "$folder/" ] || [ -n "$(find "$other/build.exit" -mtime -1 2>/dev/null)" ] || rm -rf "$other"
done
exec "$@"
"""
)


def build(link: Link, sources: Path) -> Mapping[str, str]:
    """Copy the sources of the suites, the folder recipes-tests, to the target and build them there.

    Campaigns use these suites instead of others on the target. Return what they were built with, name to value.
    Raises UsageError where the target file names other suites, TargetError with what the target lacks, or the
    compiler's lines.
    """
    target = link.target
    if target.suites is not None:
        raise UsageError(
            f"{target.name}: its target file names {target.suites} as suites, which campaigns copy to the target: "
            "leave that out to measure with what is built there"
        )
    if not (sources / "build.sh").is_file():
        raise UsageError(f"{sources}: has no build.sh: give the folder recipes-tests of this project")
    equipment = inspection.inspect(link)
    for name in OF_ROS:
        if several := inspection.several_of(target, equipment, name):
            raise TargetError(several)
    setups = [target.setup] if target.setup else [equipment.installed(name).setup for name in OF_ROS]
    if living := link.check(["sh", "-c", _LIVING_RUNS, "sh", str(target.work_dir)]).split():
        raise TargetError(f"{target.address}: a campaign measures there ({living[0]}): building would disturb it")
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    copied = deploy.deploy(link, sources, "sources")
    folder = target.work_dir / "building" / secrets.token_hex(8)
    words = [str(copied), str(folder), str(target.work_dir / BUILT), *filter(None, setups)]
    program = Program(name=NAME, argv=(str(scripts / SCRIPT), *words), deadline_s=BUILD_S)
    try:
        _start(link, scripts, folder, program)
        ended = processes.wait(link, folder, NAME, deadline_s=BUILD_S + END_GRACE_S)
        if ended.status != 0:
            raise TargetError(f"{target.address}: {_last_words(link, folder)}")
    except OUT_OF_REACH:
        raise
    except BaseException:
        processes.give_up(link, folder)
        raise
    processes.give_up(link, folder)
    return inspection.inspect(link).built_with


def _start(link: Link, scripts: PurePosixPath, folder: PurePosixPath, program: Program) -> None:
    """Start a build. Raises TargetError where another one is going on."""
    words = ["sh", "-c", _START, "sh", str(folder.parent), folder.name, *processes.call(scripts, folder, program)]
    printed = link.check(words).split()
    if printed[:1] == ["busy"]:
        group = printed[1] if printed[1:] else ""
        how = f", or end it there: kill -- -{group}" if group.isdecimal() and group.isascii() else ""
        raise TargetError(
            f"{link.target.address}: a build of suites that another call started is going on there: wait for it{how}"
        )


def _last_words(link: Link, folder: PurePosixPath) -> str:
    """The error that the script reported."""
    printed = link.run(["tail", "-n", str(SHOWN_LINES), str(folder / f"{NAME}.stderr")]).stdout
    return printed.strip()[:SHOWN_CHARACTERS] or "building the suites was ended before it was done"
