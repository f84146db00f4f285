"""The owner of an observed program gives the path of its library another meaning before a probe is placed there."""

import hashlib
import shutil
import subprocess

import pytest

from rtrun.probes import placement
from rtrun.targets import deploy

# A folder instead of tracefs: what the kernel would make in a new instance is made by mkdir.
MKDIR = f"""#!/bin/sh
{shutil.which("mkdir")} "$@" || exit
case $1 in */instances/*) ;; *) exit 0 ;; esac
{shutil.which("mkdir")} "$1/events" && printf 'field: char data; offset:16; size:4080;' >"$1/events/header_page"
"""


@pytest.fixture
def watch(tmp_path, pids_of_the_kernel):
    """Calls watch_probes.sh with lines; returns what it prints, and what it told the kernel."""
    tracing = tmp_path / "tracing"
    (tracing / "instances").mkdir(parents=True)
    for name in ("trace_marker", "uprobe_events"):
        (tracing / name).touch()
    for name in ("processes.sh", "find_programs.sh"):
        shutil.copy(deploy.ON_TARGET / name, tmp_path)
    script = tmp_path / "watch_probes.sh"
    text = (deploy.ON_TARGET / script.name).read_text().replace("/sys/kernel/tracing", str(tracing))
    # The shell of busybox would take its own.
    text = text.replace('mkdir "$instance"', f'{tmp_path}/mkdir "$instance"')
    (tmp_path / "mkdir").write_text(MKDIR)
    (tmp_path / "mkdir").chmod(0o755)

    def call(shell, *lines):
        # It calls itself.
        script.write_text(text.replace("#!/bin/sh", f"#!/usr/bin/env -S {shell}", 1))
        script.chmod(0o755)
        done = subprocess.run(
            [script, "60", "30", "64", "1000", "nothing"],
            input="\n".join([*lines, ""]),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        refused = [line for line in done.stdout.splitlines() if line.startswith("refused ")]
        placed = [line for line in (tracing / "uprobe_events").read_text().splitlines() if line.startswith("p:")]
        return refused, placed

    return call


def line_of(library, name="publish_0_1"):
    return f"p {name} {hashlib.sha256(library.read_bytes()).hexdigest()} {library}:0x10 value=%di"


@pytest.mark.parametrize("shell", ["dash", "busybox sh", "bash --posix"])
@pytest.mark.parametrize("swap", ["link", "folder", "contents", "pipe", "gone"])
def test_a_probe_is_placed_in_no_other_file(watch, tmp_path, shell, swap):
    (tmp_path / "his").mkdir()
    library, honest = tmp_path / "his/librcl.so", tmp_path / "honest.so"
    library.write_bytes(b"his own, with a function wherever he likes")
    honest.write_bytes(b"a library of the system")
    lines = [line_of(honest), line_of(library, "publish_1_1"), line_of(honest, "take_0_1")]
    system = tmp_path / "system/librcl.so"
    system.parent.mkdir()
    system.write_bytes(b"what programs of root run")
    if swap == "folder":
        (tmp_path / "his").rename(tmp_path / "moved")
        (tmp_path / "his").symlink_to(system.parent)
    else:
        library.unlink()
    if swap == "link":
        library.symlink_to(system)
    elif swap == "contents":
        library.write_bytes(b"another one of his")
    elif swap == "pipe":
        subprocess.run(["mkfifo", library], check=True)
    refused, events = watch(shell, *lines)
    assert [line.partition(":")[2].split("/", 1)[1].split()[:2] for line in events] == [
        ["publish_0_1", "/proc/self/fd/5:0x10"],
        ["take_0_1", "/proc/self/fd/5:0x10"],
    ]
    assert "refused publish_1_1 its file was replaced while the program runs: restart the program" in refused


def test_a_file_of_any_size_does_not_hold_up_the_others(tmp_path):
    """Whoever may make a sparse file, and map it, would keep root reading for hours."""
    huge = tmp_path / "librcl.so"
    with huge.open("wb") as file:
        file.truncate(1 << 42)
    script = tmp_path / "look.sh"
    # The process that maps it is this one, by a path that leads to the same file.
    script.write_text(placement._LOOK.replace("mapped=/proc/$pid/map_files/$range", f"mapped={huge}"))
    done = subprocess.run(
        ["sh", script], input=f"1:1-1 1 1-2 {huge}\n", capture_output=True, text=True, timeout=50, check=True
    )
    assert int(done.stdout.splitlines()[1].split()[2]) > placement.FILE_BYTES_MAX
