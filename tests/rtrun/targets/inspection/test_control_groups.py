"""Limits of control groups: of this machine, of version 2 by a specimen; kept by supervise.sh, and in check-rt."""

import contextlib
import os
import subprocess
import time
from pathlib import Path

import pytest

from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.inspection import rt_readiness
from rtrun.targets.inspection.control_groups import SCRIPT, ControlGroup, Throttling, limits_of, parse, parse_around

# A container of systemd on Debian 12: the quota stands two levels above the program's own group.
SPECIMEN = {
    "machine.slice/cpu.max": "20000 100000\n",
    "machine.slice/cpu.stat": "usage_usec 9\nnr_periods 50\nnr_throttled 35\nthrottled_usec 2100000\nnr_bursts 0\n",
    "machine.slice/a b.scope/cpu.max": "max 100000\n",
    "machine.slice/a b.scope/cpu.stat": "usage_usec 9\nnr_periods 0\nnr_throttled 0\nthrottled_usec 0\n",
    "cpu.stat": "usage_usec 9\n",
}

# Runs until it was throttled three times more.
BUSY = """
first=
while :; do
    while read -r name count; do [ $name = nr_throttled ] && now=$count; done <"$0"
    [ "$now" -lt $((${first:=$now} + 3)) ] || exit 0
done
"""


@pytest.mark.parametrize("shell", ["dash", "bash --posix"])
def test_version_2(tmp_path, shell):
    """The groups up to the root, without a single program in PATH."""
    for name, text in SPECIMEN.items():
        (tmp_path / "fs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "fs" / name).write_text(text)
    (tmp_path / "cgroup").write_text("0::/machine.slice/a b.scope\n")
    (tmp_path / "mountinfo").write_text(
        "24 30 0:22 / /proc rw,nosuid shared:12 - proc proc rw\n"
        f"28 24 0:25 / {tmp_path}/fs rw,nosuid shared:4 master:2 - cgroup2 cgroup2 rw,nsdelegate\n"
    )
    bare = subprocess.run(
        [f"/bin/{shell.split()[0]}", *shell.split()[1:], SCRIPT, tmp_path],
        env={"PATH": "/nonexistent"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert bare.stderr == ""
    scope, machine, root = parse(bare.stdout)
    assert (scope.path, scope.quota, root.path, root.before) == ("/machine.slice/a b.scope", None, "/", None)
    assert machine.before == Throttling(periods=50, throttled=35, throttled_ns=2_100_000_000)
    assert limits_of([scope, machine, root]) == ["/machine.slice: cpu.max 20000 of 100000 us"]


@pytest.fixture
def group():
    """A control group of this machine that limits both real-time threads and others, where it has version 1."""
    folder = Path("/sys/fs/cgroup/cpu") / f"rtrun-test-{os.getpid()}"
    try:
        folder.mkdir()
    except OSError as error:
        pytest.skip(f"no hierarchy of version 1 with the controller cpu that can be written: {error}")
    try:
        (folder / "cpu.cfs_period_us").write_text("10000")
        (folder / "cpu.cfs_quota_us").write_text("2000")
        with contextlib.suppress(OSError):  # a kernel without CONFIG_RT_GROUP_SCHED
            (folder / "cpu.rt_runtime_us").write_text("100000")
        yield folder
    finally:
        # What ends a program at its deadline may outlive it for a moment.
        for _ in range(100):
            for pid in (folder / "cgroup.procs").read_text().split():
                with contextlib.suppress(OSError):
                    (folder.parent / "cgroup.procs").write_text(pid)
            with contextlib.suppress(OSError):
                folder.rmdir()
                break
            time.sleep(0.1)
        else:
            raise RuntimeError(f"{folder} cannot be removed")


def in_group(group, *argv):
    """What a program prints that is started in a group."""
    shell = ["sh", "-c", 'echo $$ >"$0/cgroup.procs" && exec "$@"', group, *argv]
    return subprocess.run(shell, capture_output=True, text=True, check=True).stdout


def test_what_a_program_was_throttled_is_recorded(group, tmp_path):
    """Started by supervise.sh, as each program of a run is, until its quota was used up a few times."""
    in_group(group, ON_TARGET / "supervise.sh", tmp_path, "p", "60", "", "sh", "-c", BUSY, group / "cpu.stat")
    subprocess.run(["flock", "-s", tmp_path / "p.lock", "true"], check=True)
    assert (tmp_path / "p.exit").read_text().startswith("0 ")
    own = parse_around((tmp_path / "p.cgroups").read_text())[0]
    assert (own.version, own.path, own.quota) == (1, f"/{group.name}", "cpu.cfs_quota_us 2000 of 10000 us")
    assert own.before is not None and own.throttled.throttled >= 3 and own.throttled.throttled_ns > 0
    if (group / "cpu.rt_runtime_us").exists():
        assert own.rt_limit() == "cpu.rt_runtime_us 100000 of 1000000 us"


def test_check_rt_warns_of_the_groups_it_is_in(group):
    """A link whose shell is in the group: both limits are faults, each in its own words."""

    class Link:
        def check(self, argv, stdin):
            shell = 'echo $$ >"$0/cgroup.procs" && exec "$@"'
            argv = ["sh", "-c", shell, group, *argv]
            return subprocess.run(argv, input=stdin, capture_output=True, text=True, check=True).stdout

    found = rt_readiness.judge(rt_readiness.read_checks(), rt_readiness.read_facts(Link()))
    faults = {finding.check.name: finding.evidence for finding in found if finding.status == "fault"}
    assert faults["CPU quota of the control group"] == (f"/{group.name}: cpu.cfs_quota_us 2000 of 10000 us",)
    if (group / "cpu.rt_runtime_us").exists():
        expected = (f"/{group.name}: cpu.rt_runtime_us 100000 of 1000000 us",)
        assert faults["real-time budget of the control group"] == expected


@pytest.mark.parametrize(
    "wrong",
    [
        "group 3 /x\n", "group 1 /x\ncpu.rt_runtime_us 1e3\n", "group 1 /x\ncpu.cfs_quota_us -7\ncpu.rt_period_us 0\n",
        "group 2 /x\ncpu.max 99999999999999999999 1\n", "group 2 /x\ncpu.stat nr_periods x\n",
        f"group 2 /{'x' * 5000}\n",
    ],
)  # fmt: skip
def test_what_no_kernel_says_is_left_out(wrong):
    assert parse(wrong + "group 1 /\ncpu.rt_runtime_us 950000\ncpu.rt_period_us 1000000\n") == [
        ControlGroup(version=1, path="/", rt_runtime_us=950_000, rt_period_us=1_000_000)
    ]
