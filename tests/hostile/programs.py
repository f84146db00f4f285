"""Programs on a target that others want to live, or others' to end."""

import time
from pathlib import Path, PurePosixPath

from rtrun.plan.program import Program
from rtrun.targets import deploy, processes


def start(link, folder, text, name="p", deadline_s=600.0):
    program = Program(name=name, argv=("sh", "-c", text), deadline_s=deadline_s)
    processes.start(link, PurePosixPath(deploy.ON_TARGET), folder, program)
    wait_until(lambda: Path(folder / f"{name}.stderr").exists())


def wait_until(condition):
    deadline = time.monotonic() + 200
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def command_lines(link):
    """Of all processes, by number."""
    script = r"""
        for p in /proc/[0-9]*; do printf '%s %s\n' "${p#/proc/}" "$(tr '\0\n' '  ' <$p/cmdline)"; done 2>/dev/null
    """
    lines = (line.partition(" ") for line in link.check(["sh", "-c", script]).splitlines())
    return {int(number): words.strip() for number, _, words in lines}
