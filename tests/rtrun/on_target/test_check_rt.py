"""check_rt.sh on specimens: a root with /proc, /sys and /dev of a machine that this one is not. And on this one."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rtrun.targets.inspection import rt_readiness

BUSYBOX = pytest.param(
    "busybox sh", marks=pytest.mark.skipif(not shutil.which("busybox"), reason="this machine has no busybox")
)
SHELLS = ["dash", "bash --posix", BUSYBOX]
KERNEL = 0x200000
# A name that would be a line of its own, and one that a shell or a terminal would read.
LINE_END, ODD = "a\nunseen: b", "$(id) \\n\x1b[2J\udcff*"
ETHTOOL = """#!/bin/sh
[ "$2" = usb0 ] && { echo "netlink error: Operation not supported" >&2; exit 1; }
echo "Coalesce parameters for $2:
Adaptive RX: on  TX: n/a
rx-usecs:	3
rx-frames:	n/a
rx-usecs-irq: 7
"
"""
TSC = "clocksource: timekeeping watchdog on CPU1: Marking clocksource 'tsc' as unstable because the skew is too large:"


def stat(tid: int, name: str, priority: int = 0, flags: int = 0, minor: int = 0, major: int = 0) -> str:
    fields = ["0"] * 50
    fields[6], fields[7], fields[9], fields[37], fields[38] = map(
        str, (flags, minor, major, priority, int(priority > 0))
    )
    return f"{tid} ({name}) S {' '.join(fields[1:])}\n"


def process(
    pid: int, name: str, *, group: str = "/user.slice/session-1.scope", rtprio: int = 0, **more: int
) -> dict[str, str]:
    memory = {"locked": 0, "resident": 9000, **more}
    numbers = {key: value for key, value in more.items() if key not in ("locked", "resident")}
    return {
        f"proc/{pid}/task/{pid}/stat": stat(pid, name, **numbers),
        f"proc/{pid}/task/{pid}/comm": f"{name}\n",
        f"proc/{pid}/comm": f"{name}\n",
        f"proc/{pid}/cgroup": f"0::{group}\n",
        f"proc/{pid}/limits": f"Limit  Soft Limit  Hard Limit  Units\nMax realtime priority     {rtprio}  0\n",
        f"proc/{pid}/status": f"Name:\tx\nVmLck:\t{memory['locked']} kB\nVmRSS:\t{memory['resident']} kB\n",
    }


def cpus(run: int, idle: int) -> str:
    lines = "".join(f"cpu{cpu} {run if cpu == 5 else 0} 0 0 {idle} 0 0 0 0 0 0\n" for cpu in (0, 1, 4, 5))
    return f"cpu 1 2 3\n{lines}intr 1\n"


NET, CPU, PCI = "sys/class/net", "sys/devices/system/cpu", "sys/bus/pci/devices"
MACHINE = {
    "proc/cpuinfo": "processor\t: 0\nvendor_id\t: GenuineIntel\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
    f"{CPU}/isolated": "1\n",
    f"{CPU}/cpu1/topology/thread_siblings_list": "1,5\n",
    f"{CPU}/cpu5/topology/thread_siblings_list": "1,5\n",
    **process(100, "loop", priority=80, minor=10, major=1),
    **process(101, LINE_END, priority=20, locked=9100),
    **process(102, ODD, priority=20, locked=9100),
    **process(200, "ros2_control_no", group="/system.slice/docker-c0ffee.scope"),
    **process(201, "ros2_control_no", group="/machine.slice/libpod-c0ffee.scope"),
    **process(202, "ros2_control_no", group="/system.slice/robot.service", rtprio=7),
    **process(203, "rtapi_app", rtprio=98),
    **process(300, "irq/24-enp1s0-r", priority=50, flags=KERNEL),
    **process(301, "irq/25-wlan0", priority=50, flags=KERNEL),
    **process(302, "irq/26-ahci", priority=50, flags=KERNEL),
    "proc/irq/24/enp1s0-rx-0/keep": "",
    "proc/irq/25/wlan0/keep": "",
    "proc/irq/26/ahci/keep": "",
    "proc/irq/27/enp1s0/keep": "",
    f"{NET}/enp1s0/operstate": "up\n",
    f"{NET}/enp1s0/device/keep": "",
    f"{NET}/wlan0/operstate": "down\n",
    f"{NET}/wlan0/device/keep": "",
    f"{NET}/usb0/operstate": "up\n",
    f"{NET}/usb0/device/keep": "",
    f"{NET}/lo/operstate": "unknown\n",
    **{f"{NET}/{name}/{file}": "up\n" for name in ("-c", "a*b", "$(id)") for file in ("operstate", "device/keep")},
    f"{PCI}/0000:01:00.0/class": "0x030000\n",
    f"{PCI}/0000:01:00.0/power/control": "auto\n",
    f"{PCI}/0000:01:00.0/power/runtime_status": "suspended\n",
    f"{PCI}/0000:02:00.0/class": "0x020000\n",
    f"{PCI}/0000:02:00.0/power/control": "auto\n",
    "sys/class/drm/card1/device/power/control": "on\n",
    "sys/class/drm/card1/device/power/runtime_status": "active\n",
    "sys/class/drm/card1-HDMI-A-1/device/power/control": "auto\n",
    "proc/xenomai/version": "3.2.1\n",
    "sys/class/evl/keep": "",
    "dev/cpu/0/msr": "x" * 52 + "\x07" + "\0" * 7,
    "proc/stat": cpus(run=100, idle=1000),
}
# The same, a second later.
AFTER = {
    "proc/100/task/100/stat": stat(100, "loop", priority=80, minor=22, major=3),
    "dev/cpu/0/msr": "x" * 52 + "\x09" + "\0" * 7,
    "proc/stat": cpus(run=137, idle=1063),
}
EXPECTED = {
    "slow_clock": ["hpet", TSC],
    "memory": [
        "unlocked: 0 of 9000 kB, process 100, loop",
        "locked: 9100 of 9000 kB, process 101, a",
        "locked: 9100 of 9000 kB, process 102, " + ODD,
    ],
    "moderation": ["rx-usecs 3, adaptive on: enp1s0"],
    "network_threads": ["priority 50, below 80: interrupt 24 of enp1s0, waited for by loop?"],
    "gpu": [
        "auto: bus/pci/devices/0000:01:00.0 is suspended",
        "on: class/drm/card1/device is active",
    ],
    "dual_kernel": ["Xenomai 3.2.1", "EVL"],
    "faults": ["2 major and 12 minor page faults: thread 100 of process 100, loop"],
    "siblings": ["busy 37 %: CPU 5, sibling of the isolated CPU 1"],
    "management_interrupts": ["2 in a second, 9 since the start"],
}
PROGRAMS = [
    "program in docker: process 200 may have priority 0, ros2_control_no",
    "program in podman: process 201 may have priority 0, ros2_control_no",
    "program in a service: process 202 may have priority 7, ros2_control_no",
    "program in a session: process 203 may have priority 98, rtapi_app",
]
ENTER = """
cd "$1"
for folder in bin lib lib64 sbin usr; do
    [ -d /$folder ] && mkdir -p $folder && mount --bind /$folder $folder
done
: >dev/null
mount --bind /dev/null dev/null
shift
exec chroot . env PATH="/own:$PATH" "$@"
"""


def write(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, errors="surrogateescape")


def facts_in(root: Path, shell: str) -> dict[str, list[str]]:
    """The facts that the script sees in a root of its own."""
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-euc", ENTER, "sh", root, *shell.split(), "-s"],
        input=rt_readiness.SCRIPT.read_bytes(), capture_output=True, check=True,
    )  # fmt: skip
    assert done.stderr == b""
    return rt_readiness.parse(done.stdout.decode(errors="surrogateescape"))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write(tmp_path, MACHINE | {f"after/{name}": text for name, text in AFTER.items()})
    tools = {"ethtool": ETHTOOL, "dmesg": f'#!/bin/sh\necho "{TSC}"\n', "sleep": "#!/bin/sh\ncp -r /after/. /\n"}
    write(tmp_path, {f"own/{name}": text for name, text in tools.items()})
    for name in tools:
        (tmp_path / "own" / name).chmod(0o755)
    return tmp_path


@pytest.mark.root
@pytest.mark.parametrize("shell", SHELLS)
def test_what_surrounds_a_loop(root: Path, shell: str) -> None:
    facts = facts_in(root, shell)
    assert {name: facts[name] for name in EXPECTED} == EXPECTED
    assert facts["rt_scheduling"][1:] == PROGRAMS
    assert "20 program a\\nunseen: b" in facts["threads"]
    findings = rt_readiness.judge(rt_readiness.read_checks(), facts)
    assert [
        (finding.check.name, finding.evidence)
        for finding in findings
        if finding.status == "unknown" and finding.check.absent == "ok"
    ] == []


@pytest.mark.root
def test_who_refuses_a_real_time_thread(root: Path) -> None:
    """A login in a container: the file that its engine leaves in it."""
    write(root, {"own/chrt": "#!/bin/sh\necho chrt: no >&2\nexit 1\n", ".dockerenv": ""})
    (root / "own/chrt").chmod(0o755)
    assert facts_in(root, "sh")["rt_scheduling"][0] == "refused in docker: chrt: no"
    write(root, {"run/.containerenv": ""})
    assert facts_in(root, "sh")["rt_scheduling"][0] == "refused in podman: chrt: no"


@pytest.mark.root
def test_what_cannot_be_seen_is_reported(root: Path) -> None:
    shutil.rmtree(root / "dev/cpu")
    facts = facts_in(root, "env PATH=/nonexistent /bin/dash")
    assert facts["faults"] == facts["siblings"] == ["unseen: the target lacks sleep"]
    assert facts["management_interrupts"][0].startswith("unseen: root and the module msr are needed")
    unseen = {
        finding.check.name
        for finding in rt_readiness.judge(rt_readiness.read_checks(), facts)
        if finding.status == "unknown"
    }
    assert unseen >= {"page faults", "busy sibling of isolated CPU", "system management interrupts"}


BUSY = """
import mmap, os, time
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
print(flush=True)
while True:
    mmap.mmap(-1, 1 << 16).write(bytes(1 << 16))
    time.sleep(0.005)
"""


@pytest.mark.root
def test_memory_and_page_faults_on_this_machine() -> None:
    tidy = ["cyclictest", "--quiet", "--mlockall", "--policy=fifo", "--priority=1", "--interval=10000", "--threads=1"]
    with (
        subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE) as busy,
        subprocess.Popen(tidy, stdout=subprocess.DEVNULL) as locked,
    ):
        try:
            assert busy.stdout and busy.stdout.readline() == b"\n"
            while len([*Path(f"/proc/{locked.pid}/task").iterdir()]) < 2:
                assert locked.poll() is None
            script = ["sh", rt_readiness.SCRIPT]
            facts = rt_readiness.parse(subprocess.run(script, capture_output=True, text=True, check=True).stdout)
        finally:
            busy.kill()
            locked.kill()
    memory = {int(line.split(", ")[1].split()[1]): line.split(":")[0] for line in facts["memory"]}
    assert (memory[busy.pid], memory[locked.pid]) == ("unlocked", "locked")
    (line,) = [line for line in facts["faults"] if f" of process {busy.pid}, " in line]
    assert int(line.split()[3]) > 100
