"""Programs for the tests of probes: a stand-in with the functions that are probed; and what is in the trace."""

import contextlib
import os
import platform
import re
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import pytest

from rtrun.probes.libraries.description import events
from rtrun.probes.placement import place
from rtrun.probes.programs import ObservableProgram, find_programs
from rtrun.probes.session import Observed, observe
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.link import Link

TRACING = Path("/sys/kernel/tracing")
SCRIPTS = PurePosixPath(ON_TARGET)
SOURCE = Path(__file__).with_name("standin.c")
LIBRARIES = ("tracetools", "rcl")
# Those of paths are of real programs alone.
EVENTS = [event for event in events() if event not in ("wait", "guard_trigger")]


def build(
    folder: Path,
    *compiler: str,
    source: Path = SOURCE,
    libraries: Sequence[str] = LIBRARIES,
    defined: Sequence[str] = (),
) -> Path:
    """Compile a stand-in with its libraries into a folder, for this machine unless a compiler is given."""
    if not compiler:
        # As Ubuntu 24.04 compiles its packages, and Debian does not.
        ubuntu = ("-fcf-protection=branch", "-fno-omit-frame-pointer", "-mno-omit-leaf-frame-pointer")
        compiler = ("cc", *(ubuntu if platform.machine() == "x86_64" else ()))
    folder.mkdir(exist_ok=True)
    compiler = (*compiler, *(f"-D{word}" for word in defined))
    for name in libraries:
        library = ["-shared", "-fPIC", f"-DLIBRARY_{name}", "-o", f"{folder}/lib{name}.so"]
        subprocess.run([*compiler, "-O2", *library, source], check=True)
    links = [f"-L{folder}", *(f"-l{name}" for name in libraries), "-Wl,--no-as-needed,-rpath,$ORIGIN"]
    program = folder / source.stem
    subprocess.run([*compiler, "-O1", "-pthread", "-o", program, source, *links[-1:], *links[:-1]], check=True)
    return program


@contextlib.contextmanager
def running(*argv: object, **more: object) -> "Iterator[subprocess.Popen[str]]":
    """A program that is ended with the context."""
    with subprocess.Popen([str(word) for word in argv], stdout=subprocess.PIPE, text=True, **more) as process:  # type: ignore[call-overload]
        try:
            yield process
        finally:
            process.kill()


def find(
    link: Link, *pids: int, scripts: PurePosixPath = SCRIPTS, within_s: float = 30
) -> tuple[ObservableProgram, ...]:
    """Those of these processes that can be observed, once all of them can: a library is loaded after the start."""
    deadline = time.monotonic() + within_s
    while True:
        found = tuple(program for program in find_programs(link, scripts).found if program.program.pid in pids)
        if len(found) == len(pids):
            return found
        assert time.monotonic() < deadline, found
        time.sleep(0.1)


def observed(
    link: Link, *pids: int, for_s: float = 3600, limit_per_s: int = 40_000, **more: object
) -> Iterator[Observed]:
    """What is seen of these processes."""
    found = find(link, *pids)
    placement = place(link, found, events=EVENTS)
    return observe(link, SCRIPTS, placement, found, for_s=for_s, limit_per_s=limit_per_s, **more)  # type: ignore[arg-type]


def left() -> list[str]:
    """What observations of this test process have in this machine's trace; those of other workers have more there."""
    ours = re.compile(
        rf"rtrun[-_]observe[-_](?:raw_)?{Path('/proc/self/ns/pid').stat().st_ino}_([0-9]+)_[0-9]+", re.ASCII
    )
    probes = (line.partition(" ")[0] for line in (TRACING / "uprobe_events").read_text().splitlines())
    instances = (path.name for path in TRACING.glob("instances/*"))
    found = {name: match[1] for name in (*probes, *instances) if (match := ours.search(name))}
    return sorted(name for name, pid in found.items() if not _is_of_another_worker(pid))


def _is_of_another_worker(pid: str) -> bool:
    """Whether what takes the probes off lives, and was started by another worker on this machine itself."""
    try:
        environment = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return False
    workers = {variable for variable in environment if variable.startswith(b"PYTEST_XDIST_WORKER=")}
    return bool(workers - {f"PYTEST_XDIST_WORKER={os.environ.get('PYTEST_XDIST_WORKER', '')}".encode()})


def wait_until_nothing_is_left() -> None:
    """A watchdog needs some tenths of a second; a busy machine has more time."""
    deadline = time.monotonic() + 30
    while left():
        assert time.monotonic() < deadline, left()
        time.sleep(0.05)


def scripts_of_busybox(folder: Path) -> PurePosixPath:
    """The scripts of an observation, made anew in a folder, with a shell and tools that are BusyBox's."""
    tools, scripts = folder / "bin", folder / "scripts"
    tools.mkdir()
    scripts.mkdir()
    subprocess.run(["busybox", "--install", "-s", tools], check=True)
    for path in (*Path(str(SCRIPTS)).glob("*pro*.sh"), Path(str(SCRIPTS)) / "find_threads.sh"):
        (scripts / path.name).write_text(path.read_text().replace("#!/bin/sh\n", f"#!{tools}/sh\nPATH={tools}\n", 1))
        (scripts / path.name).chmod(0o755)
    return PurePosixPath(scripts)


def skip_without_trace() -> None:
    """Skip where this user, or this kernel, has no probes."""
    if not os.access(TRACING / "uprobe_events", os.W_OK):
        pytest.skip("no probes here: they take root, and tracefs with uprobe_events")


def tell(line: str) -> None:
    """Add a line to the probes of this machine; opened to be written anew, the file would lose all others."""
    handle = os.open(TRACING / "uprobe_events", os.O_WRONLY | os.O_APPEND)
    try:
        os.write(handle, f"{line}\n".encode())
    finally:
        os.close(handle)
