"""What a target says of itself, read into types."""

import contextlib
import fcntl
import json
import platform
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from rtfiles.errors import UsageError
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import architecture
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import Link

THREAD = "12 (a) b) S " + " ".join("0" * 36) + " "


def real_time_threads():
    """Those of the kernel, which stay: field 40 of each stat is its priority (proc(5))."""
    threads = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            pid, _, rest = path.read_text(errors="replace").partition(" ")
            fields = rest.rpartition(") ")[2].split()
            if fields[1] == "2" and fields[37] != "0":  # the parent is kthreadd
                threads.add(int(pid))
    return threads


def test_the_state_of_this_machine():
    real_time = real_time_threads()
    done = subprocess.run(["sh", ON_TARGET / "state.sh"], capture_output=True, text=True, check=True)
    state = inspection.parse_state(done.stdout)
    assert state.kernel_release == Path("/proc/sys/kernel/osrelease").read_text().strip()
    assert state.boot_id == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert state.threads > len(state.rt_threads)
    assert {thread.tid for thread in state.rt_threads} >= real_time
    assert state.cpuinfo and state.cpuinfo.startswith("processor")
    assert inspection.TargetState.model_validate(state.model_dump()) == state


def test_one_value_several_and_none():
    state = inspection.parse_state(
        "== governor\nperformance\nondemand\n== machine\narmv7l\n== realtime\n== unheard_of\n1\n"
    )
    assert (state.governor, state.machine, state.realtime) == (["performance", "ondemand"], "armv7l", None)
    assert state.clocksource is None


@pytest.mark.parametrize("uptime", ["since Tuesday", "", "1e300 2", "-1 2", "1\n2"])
def test_facts_have_types_and_what_is_none_is_left_out(uptime):
    text = (
        "== uptime\n{}\n== machine\narmv7l\n== temperature_mc\n{}\n== sched_rt_runtime_us\n{}\n== frequency_khz\n8\n9\n"
    )
    state = inspection.parse_state(text.format("12.50 20.00", "41000", "-1"))
    assert (state.uptime, state.temperature_mc, state.sched_rt_runtime_us) == (12.5, [41000], -1)
    state = inspection.parse_state(text.format(uptime, "-1000001", 2**31))
    assert (state.uptime, state.temperature_mc, state.sched_rt_runtime_us) == (None, [], None)
    assert (state.machine, state.frequency_khz) == ("armv7l", [8, 9])


def test_real_time_threads():
    text = "== threads\n" + "".join(f"{THREAD}{words}\n" for words in ("95 1", "40 7", "0 6", "0 1")) + "13\n"
    state = inspection.parse_state(text)
    assert state.threads == 13
    threads = [(thread.tid, thread.name, thread.policy, thread.priority) for thread in state.rt_threads]
    assert threads == [(12, "a) b", "FIFO", 95), (12, "a) b", "7", 40), (12, "a) b", "DEADLINE", 0)]


@pytest.mark.parametrize(
    "line",
    [
        "9" * 5000 + " (a) S " + "0 " * 50,
        THREAD + "9" * 5000 + " 1",
        THREAD + "² 1",
        THREAD + "-1 1",
        "1 (" + "x" * 100_000 + ") S " + "0 " * 50,
        "1 (a) S",
        "",
    ],
)
def test_a_thread_that_is_none(line):
    state = inspection.parse_state(f"== threads\n{line}\n{line}\n")
    assert (state.threads, state.rt_threads) == (0, [])


@pytest.mark.parametrize(
    ("version", "realtime", "expected"),
    [
        ("#1 SMP PREEMPT_RT Debian 6.1.176-1", None, True),
        ("#1 SMP PREEMPT RT Thu Apr 24 2014", None, True),
        ("#1 SMP PREEMPT_DYNAMIC", None, False),
        ("#1 SMP PREEMPT", "1", True),
        (None, None, False),
    ],
)
def test_preempt_rt(version, realtime, expected):
    state = inspection.TargetState(kernel_version=version, realtime=realtime)
    assert inspection.is_preempt_rt(state) is expected


def header(width, order, machine):
    return b"\x7fELF" + bytes([width, order]) + bytes(12) + machine.to_bytes(2, "big" if order == 2 else "little")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (header(1, 1, 40), "32-bit ARM"),
        (header(2, 1, 183), "64-bit ARM"),
        (header(2, 1, 62), "64-bit x86"),
        (header(1, 2, 8), "32-bit MIPS, big-endian"),
        (header(2, 1, 999), "64-bit machine 999"),
        (header(2, 1, 62)[:-1], None),
        (b"#!/bin/sh\n" + bytes(20), None),
        (b"", None),
    ],
)
def test_architectures(content, expected):
    assert architecture.name(content) == expected


@pytest.mark.sshd
def test_the_equipment_of_this_machine(link):
    equipment = inspection.inspect(link)
    assert equipment.architecture == architecture.name(Path("/bin/sh").read_bytes()[: architecture.HEADER_BYTES])
    system = platform.freedesktop_os_release()
    assert equipment.debian == (system.get("VERSION_CODENAME") if system["ID"] == "debian" else None)
    assert equipment.architecture is not None and equipment.cpus >= 1 and equipment.free_bytes > 0


@pytest.mark.sshd
@pytest.mark.parametrize("library", ["rcl", "rclcpp"])
def test_a_ros2_beside_the_file_that_sets_it_up(link, tmp_path, library):
    """And suites that were built in a workspace on top of one: there, the library is elsewhere."""
    program = f"lib/cyclic_timer_tests/cyclic_timer_tests_{library}"
    link.target = replace(link.target, setup=f"{tmp_path}/setup.sh")
    for name in (program, f"lib/lib{library}.so", f"share/{library}/package.xml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("<version>1.2.3</version>\n")
        (tmp_path / name).chmod(0o755)
        equipment = inspection.inspect(link)
        assert equipment.programs[f"cyclic_timer_tests_{library}"] == f"{tmp_path}/{program}"
    found = {name for name, installed in equipment.middlewares.items() if installed.version == "1.2.3"}
    assert found == {library} and equipment.installed(library).setup == f"{tmp_path}/setup.sh"


@pytest.mark.sshd
@pytest.mark.parametrize(
    ("line", "expected"),
    [("cpus ²", 1), ("cpus 6" + "0" * 5000, 1), ("cpus 4", 4), ("free_kib x", 1), ("elf zz", 1), ("debian a b", 1)],
)
def test_facts_that_are_nonsense(link, monkeypatch, tmp_path, line, expected):
    script = tmp_path / "inspect.sh"
    script.write_text(f"echo '{line}'\n")
    monkeypatch.setattr(inspection, "SCRIPT", script)
    equipment = inspection.inspect(link)
    assert (equipment.cpus, equipment.debian) == (expected, None)


@pytest.mark.sshd
def test_suites_for_another_release_of_debian(link, tmp_path):
    equipment = replace(inspection.inspect(link), debian="trixie")

    def check(record):
        (tmp_path / "build.json").write_text(json.dumps(record))
        inspection.check_suites(tmp_path, link.target, equipment)

    for record in ({}, {"debian": None}, {"debian": "trixie"}):
        check(record)
    with pytest.raises(UsageError) as raised:
        check({"debian": "bookworm"})
    message = str(raised.value)
    assert message.startswith(
        f"{tmp_path}: suites for Debian bookworm, but {link.target.address} has trixie's libraries: "
    )
    assert message.endswith(" suites build --suite trixie")
    equipment = replace(equipment, debian=None)
    check({"debian": "bookworm"})


@pytest.mark.sshd
@pytest.mark.root
def test_a_target_whose_files_cannot_be_locked(without_locks):
    """Its kernel lacks FILE_LOCKING, or its file system has no locks: each program would seem to run for ever."""
    message = (
        r"cannot be locked \(flock: Function not implemented\): the runner needs a kernel with CONFIG_FILE_LOCKING"
    )
    with Link(without_locks, print) as link, pytest.raises(TargetError, match=message):
        inspection.inspect(link)


@pytest.mark.sshd
def test_a_lock_that_is_taken_is_no_broken_one(link):
    inspection.inspect(link)
    with Path(link.target.work_dir, ".rt-tests").open() as mark:
        fcntl.flock(mark, fcntl.LOCK_EX)
        inspection.inspect(link)
