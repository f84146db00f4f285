"""The readiness check: facts against expectations, the script in a bare shell, the command over a real sshd."""

import contextlib
import gzip
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from rtfiles.config import parse as parse_config
from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.commands import check_rt
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection import rt_readiness
from rtrun.targets.inspection.platform import Platform

# A PandaBoard ES as omap2plus_defconfig leaves it, with everything wrong that can be.
BAD = """\
== kernel
6.1.176-microsoft-standard-WSL2
== kernel_version
#1 SMP PREEMPT Thu Apr 24 00:00:00 UTC 2014
== config
CONFIG_RT_GROUP_SCHED=y
CONFIG_NO_HZ_IDLE=y
CONFIG_PROVE_LOCKING=y
CONFIG_IRQSOFF_TRACER=y
CONFIG_DEBUG_PREEMPT=y
== clocksource
32k_counter
== clockevent
clockevents/clockevent0/current_device local_timer
== high_resolution
0
0
== governor
cpu/cpu0/cpufreq/scaling_governor ondemand
== frequency
limited: cpu0/cpufreq runs at 350000 kHz, may 700000, can 920000
lowered: cpu1/cpufreq runs at 350000 kHz, may 920000, can 920000
== cooling
thermal-cpufreq-0 2
== idle_states
2 us to leave C1 (cpu0/cpuidle/state0)
768 us to leave C2 (cpu0/cpuidle/state1)
== swap
Filename Type Size Used Priority
/dev/mmcblk0p3 partition 1048572 0 -2
== huge_pages
[always] madvise never
== same_pages
1
== watchdog
watchdog 1
== rt_runtime
950000
== control_groups
/lab: cpu.rt_runtime_us 100000 of 1000000 us
/lab: cpu.max 20000 of 100000 us
== rt_scheduling
refused: chrt: failed to set pid 0's policy: Operation not permitted
refused in podman: chrt: failed to set pid 0's policy: Operation not permitted
program in docker: process 7 may have priority 0, ros2_control_no
program in a service: process 8 may have priority 0, ros2_control_no
program in a session: process 9 may have priority 0, jackd
== timer_migration
1
== turbo_mode
Y
== isolated
none
== interrupts
82/ehci_hcd:usb1/ on CPU 1
== tracer
function
== threads
99 program busy (node) x
deadline program control (1000000/10000000/10000000 ns of runtime/deadline/period)
deadline kernel sugov:0
== slow_clock
acpi_pm
== memory
unlocked: 4 of 26016 kB, process 3492, loop
== moderation
rx-usecs 3, adaptive unknown: eth0
== network_threads
priority 50, below 80: interrupt 24 of eth0, waited for by loop?
== gpu
auto: bus/pci/devices/0000:01:00.0 is active
== dual_kernel
EVL
== faults
2 major and 12 minor page faults: thread 3492 of process 3492, loop
== siblings
busy 37 %: CPU 5, sibling of the isolated CPU 1
== management_interrupts
2 in a second, 9 since the start
"""

GOOD = """\
== kernel
6.1.176-rt64
== kernel_version
#1 SMP PREEMPT_RT Thu Apr 24 00:00:00 UTC 2014
== config
CONFIG_PREEMPT_RT=y
# CONFIG_RT_GROUP_SCHED is not set
CONFIG_HZ_PERIODIC=y
== clocksource
dmtimer
== clockevent
== high_resolution
1
1
== governor
cpu/cpu0/cpufreq/scaling_governor performance
cpu/cpu1/cpufreq/scaling_governor userspace
== frequency
full: cpu0/cpufreq runs at 920000 kHz, may 920000, can 920000
== cooling
thermal-cpufreq-0 0
gpio-fan 1
== idle_states
== swap
Filename Type Size Used Priority
== huge_pages
== same_pages
0
== watchdog
watchdog 0
== rt_runtime
-1
== rt_scheduling
granted
== timer_migration
0
== turbo_mode
N
== isolated
1
== interrupts
== tracer
nop
== threads
99 kernel migration/0
95 program oneshot_timer_t
50 kernel irq/82-ehci_hcd
== memory
locked: 68320 of 2924 kB, process 3867, cyclictest
== moderation
rx-usecs 0, adaptive off: eth0
== gpu
on: class/drm/card0/device is active
== faults
== siblings
busy 3 %: CPU 5, sibling of the isolated CPU 1
== management_interrupts
0 in a second, 9 since the start
"""


def findings(text):
    return rt_readiness.judge(rt_readiness.read_checks(), rt_readiness.parse(text))


def test_every_check_finds_its_fault_on_a_bad_system():
    results = findings(BAD)
    assert {finding.check.name for finding in results if finding.status != "fault"} == set()
    assert not rt_readiness.is_ready(results)
    severities = [rt_readiness.SEVERITIES.index(finding.check.severity) for finding in results]
    assert severities == sorted(severities)
    shown = {finding.check.name: finding.evidence for finding in results}
    assert shown["idle states"] == ("768 us to leave C2 (cpu0/cpuidle/state1)",)
    assert shown["threads at priority 99"] == ("99 program busy (node) x",)
    (budget,) = shown["threads at SCHED_DEADLINE"]
    assert budget.startswith("deadline program control (1000000/10000000/10000000 ns of")
    assert shown["swap"] == ("/dev/mmcblk0p3 partition 1048572 0 -2",)


@pytest.mark.parametrize(
    ("severity", "is_ready"), [("fatal", False), ("high", False), ("medium", True), ("info", True)]
)
def test_a_fault_of_each_severity_alone(severity, is_ready):
    check = next(check for check in rt_readiness.read_checks() if check.name == "swap")
    alone = check.model_copy(update={"severity": severity})
    (finding,) = rt_readiness.judge([alone], rt_readiness.parse(BAD))
    assert finding.status == "fault"
    assert rt_readiness.is_ready([finding]) is is_ready


def test_no_check_finds_fault_on_a_good_system():
    results = findings(GOOD)
    assert [(finding.check.name, finding.evidence) for finding in results if finding.status != "ok"] == []
    assert rt_readiness.is_ready(results)


@pytest.mark.parametrize("version", ["#1 SMP PREEMPT_RT Debian 6.1.176-1", "#1 SMP PREEMPT RT Thu Apr 24 2014"])
def test_both_ways_a_kernel_says_rt(version):
    facts = rt_readiness.parse(GOOD) | {"kernel_version": [version]}
    assert rt_readiness.is_ready(rt_readiness.judge(rt_readiness.read_checks(), facts))


def test_preempt_dynamic_is_not_rt():
    facts = rt_readiness.parse(GOOD) | {"kernel_version": ["#1 SMP PREEMPT_DYNAMIC"]}
    results = rt_readiness.judge(rt_readiness.read_checks(), facts)
    assert (results[0].check.name, results[0].status) == ("PREEMPT_RT", "fault")


def test_a_target_that_tells_nothing_is_unknown_and_not_praised():
    unknown = {finding.check.name for finding in findings("") if finding.status == "unknown"}
    assert {"PREEMPT_RT", "clocksource", "real-time scheduling"} <= unknown


def test_what_was_not_seen_is_neither_right_nor_a_fault():
    facts = rt_readiness.parse(GOOD)
    for lines, expected in (
        (["unseen: the target lacks ethtool"], ("unknown", ("the target lacks ethtool",))),
        (["unseen: one card", "rx-usecs 3, adaptive off: eth0"], ("fault", ("rx-usecs 3, adaptive off: eth0",))),
        (["unseen: one card", "rx-usecs 0, adaptive off: eth0"], ("unknown", ("one card",))),
    ):
        results = rt_readiness.judge(rt_readiness.read_checks(), facts | {"moderation": lines})
        (found,) = [finding for finding in results if finding.check.fact == "moderation"]
        assert (found.status, found.evidence) == expected


def test_what_a_target_says_cannot_drive_a_terminal(capsys):
    facts = rt_readiness.parse(BAD) | {"turbo_mode": ["Y\x1b[2J" + "x" * 500]}
    findings = rt_readiness.judge(rt_readiness.read_checks(), facts)
    (line,) = {finding.check.name: finding.evidence for finding in findings}["smsc95xx turbo_mode"]
    assert len(line) == rt_readiness.SHOWN_CHARACTERS
    check_rt._print("board", False, findings)
    output = capsys.readouterr().out
    assert "  found   Y?[2Jx" in output and "\x1b" not in output


def test_a_check_with_two_expressions_is_refused():
    check = {
        "name": "x",
        "severity": "high",
        "fact": "f",
        "none": "a",
        "some": "b",
        "absent": "ok",
        "why": "w",
        "remedy": "r",
    }
    with pytest.raises(UsageError, match="give one of none and some"):
        parse_config({"schema": 1, "checks": [check]}, rt_readiness.Checks, "here")


@pytest.mark.parametrize("shell", ["dash", "bash --posix"])
def test_the_script_needs_nothing_but_a_shell(shell):
    """Without a single program in PATH, and with: the same facts; and every fact that a check looks at is there."""
    path = {"PATH": "/nonexistent"}
    bare = subprocess.run(
        [f"/bin/{shell.split()[0]}", *shell.split()[1:], rt_readiness.SCRIPT],
        env=path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert bare.stderr == ""
    facts = rt_readiness.parse(bare.stdout)
    assert {check.fact for check in rt_readiness.read_checks()} <= facts.keys() | {"control_groups"}
    kernel = subprocess.run(["uname", "-r", "-v"], capture_output=True, text=True, check=True).stdout.strip()
    assert " ".join(facts["kernel"] + facts["kernel_version"]) == kernel
    assert {line.split(" ", 2)[2] for line in facts["threads"]} >= {name for name in rt_threads() if name}


as_root = pytest.mark.root("needs a right of root's")
AS_OTHER = pytest.param(["setpriv", "--reuid=65534", "--clear-groups"], marks=as_root)


@pytest.mark.parametrize("login", [[], AS_OTHER])
def test_real_time_scheduling_is_asked_of_the_kernel(login):
    """Whatever the kernel's configuration says: where a thread becomes a real-time one, nothing is at fault."""
    # As on a target, through standard input: who logs in may not read this checkout, as where that is below /root.
    argv, text = [*login, "sh", "-s"], rt_readiness.SCRIPT.read_text()
    script = subprocess.run(argv, input=text, capture_output=True, text=True, check=True, cwd="/").stdout
    tried = subprocess.run([*login, "chrt", "-f", "1", "true"], capture_output=True, check=False)
    line = rt_readiness.parse(script)["rt_scheduling"][0]
    assert line == "granted" if tried.returncode == 0 else re.match("refused(?: in docker| in podman)?: chrt: ", line)
    tries = [finding for finding in findings(script) if finding.check.name.startswith("real-time scheduling")]
    assert [finding.status for finding in tries].count("fault") == (0 if tried.returncode == 0 else 1)


@as_root
def test_a_thread_at_sched_deadline_is_shown():
    budget = ["--sched-runtime", "1000000", "--sched-deadline", "50000000", "--sched-period", "100000000"]
    with subprocess.Popen(["chrt", "-d", *budget, "0", "sleep", "60"]) as process:
        while process.poll() is None and Path(f"/proc/{process.pid}/comm").read_text() != "sleep\n":
            pass
        scripts = (rt_readiness.SCRIPT, inspection.STATE_SCRIPT)
        facts, state = (
            subprocess.run(["sh", script], capture_output=True, text=True, check=True).stdout for script in scripts
        )
        process.kill()
    expected = "deadline program sleep (1000000/50000000/100000000 ns of runtime/deadline/period)"
    assert expected in rt_readiness.parse(facts)["threads"]
    (thread,) = [thread for thread in inspection.parse_state(state).rt_threads if thread.tid == process.pid]
    assert (thread.name, thread.policy, thread.priority) == ("sleep", "DEADLINE", 0)


def rt_threads():
    """Names of the threads that the kernel gives a real-time priority, asked in another way."""
    for task in Path("/proc").glob("[0-9]*/task/[0-9]*"):
        with contextlib.suppress(OSError):
            if os.sched_getparam(int(task.name)).sched_priority > 0:
                yield (task / "comm").read_text().rstrip("\n")


def target_file(sshd, folder):
    path = folder / "target.yml"
    lines = ["schema: 1", "name: loopback", "kind: ssh", "host: 127.0.0.1", f"port: {sshd.port}", f"user: {sshd.user}"]
    path.write_text("\n".join([*lines, f"key: {sshd.key}", f"host_key: {sshd.host_key}"]) + "\n")
    return path


@pytest.mark.sshd
def test_command_over_ssh(sshd, tmp_path, capsys):
    path = target_file(sshd, tmp_path)
    status = main(["check-rt", "--target", str(path), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert status == (0 if printed["ready"] else 1)
    assert len(printed["checks"]) == len(rt_readiness.read_checks()) and printed["platform"] in list(Platform)
    assert all({"name", "severity", "status", "found", "why", "remedy"} == check.keys() for check in printed["checks"])
    rt = next(check for check in printed["checks"] if check["name"] == "PREEMPT_RT")
    uname = subprocess.run(["uname", "-v"], capture_output=True, text=True, check=True).stdout
    assert (rt["status"] == "ok") == ("PREEMPT_RT" in uname)
    main(["check-rt", "--target", str(path)])
    out = capsys.readouterr().out
    assert out.startswith(f"loopback ({sshd.user}@127.0.0.1")
    # Not those found before: other tests begin and end threads of high priority meanwhile.
    faults = re.findall(r"^(\w+): (.+)$", out.partition("\n")[2], re.M)
    assert set(faults) <= {(check["severity"], check["name"]) for check in printed["checks"]}
    assert any(name == "PREEMPT_RT" for _, name in faults) == (rt["status"] == "fault")
    assert not faults or f": {len(faults)} of {len(printed['checks'])} checks find fault" in out


@pytest.mark.sshd
def test_save_config(sshd, tmp_path, capsys):
    from rtrun.targets.inspection import facts as inspection

    saved = tmp_path / "config.gz"
    main(["check-rt", "--target", str(target_file(sshd, tmp_path)), "--save-config", str(saved)])
    capsys.readouterr()
    text = subprocess.run(["sh", "-c", inspection._KERNEL_CONFIG], capture_output=True, text=True, check=True).stdout
    if text:
        assert gzip.decompress(saved.read_bytes()).decode() == text
    else:
        assert not saved.exists()


def test_no_such_target(tmp_path, capsys):
    assert main(["check-rt", "--target", str(tmp_path / "none.yml")]) == 2
    assert "none.yml" in capsys.readouterr().err
