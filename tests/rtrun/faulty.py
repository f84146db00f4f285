"""A stand-in for cyclic_timer_tests that goes wrong on request: what no real suite would do when a test needs it."""

import json
import sys
import time
from pathlib import Path
from typing import Any

from logs import LOGS_2014
from rtrun.evidence.attempts import lost_attempts
from rtrun.execution import campaign_runner
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import UNTRACED, Run
from rtrun.results.reading import find_source
from rtrun.results.record import read_record
from rtrun.targets.address import Address
from rtrun.targets.config import Target
from watching import Watching

PROGRAM = """#!{python}
import json, os, subprocess, sys, time
sys.path.insert(0, {here!r})
from pathlib import Path
from written import write_npy, write_output

words = dict(zip(sys.argv[1::2], sys.argv[2::2]))
count, frequency = int(words.get("-r", 1000)), int(words.get("-f", 1000))
options = (("--clock", "clock", str), ("--rt-scope", "rt_scope", str), ("--cpu", "cpu", str),
    ("--priority", "priority", int), ("--break-trace", "break_trace_us", int),
    ("--trace-threshold", "trace_threshold_us", int))
known = {{key: kind(words[flag]) for flag, key, kind in options if flag in words}}
wishes = Path({wishes!r}).read_text().splitlines()
wish = wishes[0]
Path({wishes!r}).write_text("\\n".join(wishes[1:] or ["ok"]))
with open({journal!r}, "a") as journal:
    journal.write(f"{{count}} {{frequency}} {{wish}}\\n")
output = f"cyclic_timer_tests_l{{count}}_fq{{frequency}}"
if "-s" in words:
    output += "-tnRT" + words["-s"]
if wish.startswith("sleep"):
    time.sleep(float(wish.split()[1]))
if wish.startswith("await"):
    while not Path(wish.split()[1]).exists():
        time.sleep(0.05)
if wish == "fail":
    print("\\tINFO: trying")
    print("\\tERROR: cannot set RR priority 95: CAP_SYS_NICE is missing", file=sys.stderr)
    sys.exit(1)
if wish == "silent":
    sys.exit(0)
instance = Path("/sys/kernel/tracing/instances/rtrun")
if wish.startswith("traced"):
    indices = [int(index) for index in wish.split()[1:]]
    for index in indices:
        Path(f"{{output}}-trace-{{index}}.txt").write_text((instance / "trace_clock").read_text())
    Path("passwd-trace-1.txt").write_text("not of this run")
if wish == "part":
    write_npy(Path(output + ".npy.part"), [(1,), (2,), (0,)], announced=count + 1)
    os.kill(os.getpid(), 9)
if wish == "killed":
    os.kill(os.getpid(), 9)
begun = time.monotonic_ns()  # two runs never measure at the same time
due = [1_800_000_000 * 10**9 + n * 10**9 // frequency for n in range(count + 1)]
late = 1_000_000 - 10**9 // frequency
rows = [(begun + each - due[0] + late, each, each + late) for each in due]
path = write_output(Path("."), output, "cyclic_timer_tests", rows, requested={{"repetitions": count,
    "frequency_hz": frequency, "policy": words.get("-s", "0"), **known}}, asked=count, measured=count)
data = json.loads(path.read_text())
policy = "0" if wish == "no policy" else words.get("-s", "0")
data["in_effect"]["threads"][0].update(policy="OTHER" if policy == "0" else policy, priority=95 * (policy != "0"))
data["counts"]["missing"] += wish == "miscounted"
data["counts"]["asked"] += wish == "misheard"
path.write_text(json.dumps(data))
print("\\tINFO: done")
if wish == "commands":
    Path(output + ".log").write_text('set ylabel "`touch obeyed`"\\n# Plot data for gnuplot\\nend\\n')
if wish == "incomplete":
    data = json.loads(path.read_text())
    data.update(complete=False, incomplete_reason="the publisher ended")
    path.write_text(json.dumps(data))
if wish == "truncated":
    npy = Path(output + ".npy")
    npy.write_bytes(npy.read_bytes()[:-5])
if wish == "huge json":
    with path.open("r+b") as stream:
        stream.truncate(1 << 30)
if wish in ("huge.log", "huge-trace-1.txt"):
    with open(output + wish.removeprefix("huge"), "w") as stream:
        stream.truncate(1 << 27)
if wish == "link":
    path.unlink()
    path.symlink_to("/etc/passwd")
if wish == "2014":
    log = Path({data!r}, "cyclic_timer_tests_l300_fq1000-tnRTRR.log")
    Path(output + ".log").write_text(log.read_text().replace(log.stem, output))
    path.unlink()
    path.with_suffix(".npy").unlink()
if wish == "deep json":
    path.write_text('{{"schema": ' + "[" * 50_000 + "]" * 50_000 + "}}")
if wish == "digits":
    path.write_text(path.read_text().replace('"schema": 1', '"schema": ' + "1" * 6000))
if wish == "surrogate":
    path.write_text(path.read_text().replace("0.1.0", chr(92) + "ud800"))
if wish.startswith("full"):
    while "end " not in Path("sampler.stdout").read_text():
        time.sleep(0.05)
    sys.stdout.flush()
    with open("ballast", "wb", buffering=0) as ballast:
        try:
            while True:
                ballast.write(bytes(4096))
        except OSError:
            pass
if wish == "full for long":
    for _ in range(1200):  # until the last block of the sampler is full
        if not Path("sampler.exit").exists():
            time.sleep(0.1)
    os.unlink("ballast")
if wish == "busy":
    Path("mounted").mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "mounted"], check=True)
if wish == "flood":
    for index in range(10_000):
        Path(f"{{output}}-trace-{{index}}.txt").touch()
if wish == "untold trace":
    for index in range(20):
        Path(f"{{output}}-trace-{{index}}.txt").write_text("x")
if wish == "junk json":
    path.write_text("[1, 2")
"""


def write_faulty_suites(folder: Path) -> "Wishes":
    """Make a folder as `rtgen suites build` does, whose cyclic_timer_tests obeys the returned wishes."""
    wishes = Wishes(folder)
    program = folder / "lib" / "cyclic_timer_tests" / "cyclic_timer_tests"
    program.parent.mkdir(parents=True)
    program.write_text(
        PROGRAM.format(
            python=sys.executable,
            here=str(Path(__file__).parent),
            data=str(LOGS_2014),
            wishes=str(wishes.wishes),
            journal=str(wishes.journal),
        )
    )
    program.chmod(0o755)
    (folder / "build.json").write_text("{}")
    wishes.will()
    return wishes


class Wishes:
    """What the next runs shall do, and what they did."""

    def __init__(self, folder: Path) -> None:
        self.wishes = folder.with_name(folder.name + ".wishes")
        self.journal = folder.with_name(folder.name + ".journal")

    def will(self, *wishes: str) -> None:
        """Let the next calls do these, one each, and all after them be fine."""
        temporary = self.wishes.with_suffix(".new")
        temporary.write_text("\n".join([*wishes, "ok"]))
        temporary.replace(self.wishes)

    def calls(self) -> list[str]:
        """Every call so far: repetitions, frequency, what it did."""
        return self.journal.read_text().splitlines() if self.journal.exists() else []

    def await_calls(self, count: int = 1) -> None:
        """Wait until so many calls have been made."""
        while len(self.calls()) < count:
            time.sleep(0.05)


def target_file(target: Target, ros_master: int) -> dict[str, Any]:
    """The target file of a loopback target, whose ROS master listens on this port."""
    address = target.address
    assert isinstance(address, Address)
    return {
        "schema": 1,
        "name": target.name,
        "kind": "ssh",
        "host": address.host,
        "port": address.port,
        "user": address.user,
        "key": str(address.key),
        "host_key": address.host_key,
        "work_dir": str(target.work_dir),
        "ros_master_port": ros_master,
    }


def write_files(folder: Path, target: Target, count: int) -> list[str]:
    """Write the files of a campaign of so many short runs on a target, whose suites are beside; the words for rtrun."""
    frequencies = [100 + number for number in range(count)]
    (folder / "campaign.yml").write_text(
        f"schema: 1\nname: test\nruns: [{{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: {frequencies}}}]\n"
    )
    file = target_file(target, target.master_port) | {"suites": "suites", "reconnect_s": 2}
    (folder / "target.yml").write_text(json.dumps(file))
    return ["run", str(folder / "campaign.yml"), "--target", str(folder / "target.yml")]


def runs_of(count: int, **parameters: Any) -> list[Run]:
    """So many short runs of cyclic_timer_tests, of frequencies from 100 Hz on; traced ones without their twins."""
    entry = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": [100 + n for n in range(count)]}
    runs = plan(Campaign(schema=1, name="test", runs=[entry | parameters]), "test")
    return [run for run in runs if run.trace != UNTRACED]


def measure(target: Target, runs: list[Run], results: Path, watching: Watching | None = None) -> list[str]:
    """Measure a campaign called test; the statuses of its runs."""
    return list(campaign_runner.run_campaign(target, "test", runs, results, watching or Watching()).values())


def lost(results: Path) -> list[str]:
    """The attempts in a folder that count as late."""
    source = find_source(results)
    return [
        str(attempt)
        for attempt in lost_attempts(source, {folder: read_record(folder) for folder in source.folders}, {})
    ]


def record(results: Path, run: Run) -> dict[str, Any]:
    """The run.json of a run."""
    return json.loads((results / run.name / "run.json").read_text())
