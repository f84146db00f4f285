"""What was observed is kept, whatever ends the observation: as test_observation_kept.py, on a target that is made up.

So it needs no kernel trace, and what goes wrong does so in the runner: signals, its disk, its memory, its own defects.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from datetime import timedelta
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from rtfiles.errors import InfrastructureError
from rtrun.cli import main
from rtrun.execution import board, observation, resumption, run_execution, stream_runs, system
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.probes import session
from rtrun.probes.placement import PlacedProbe, Placement
from rtrun.results.journal import Journal
from rtrun.targets import deploy
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.facts import TargetState

pytestmark = pytest.mark.timeout(120)
STEADY = Path(__file__).with_name("steady_observer.py")
MESSAGE = {"endpoint": "%di:u64", "source_ns": "%dx:s64", "topic": "+0(%si):string"}
PROBES = tuple(
    PlacedProbe(name=name, line="", event=name[:-4], arguments=MESSAGE, constants={}, path="/x")
    for name in ("publish_0_0", "take_0_1")
)


@pytest.fixture
def target(tmp_path, monkeypatch):
    """A function that makes a target file of this machine, whose watch_probes.sh does what these words say."""
    scripts = tmp_path / "scripts"
    shutil.copytree(str(deploy.ON_TARGET), scripts)
    watched = observation.Watched(found=(), placement=Placement(probes=PROBES, refused=()))
    monkeypatch.setattr(deploy, "ON_TARGET", scripts)
    monkeypatch.setattr(observation, "watch", lambda *_, **__: watched)
    monkeypatch.setattr(system, "wait_ready", lambda *_, **__: None)

    def make(*words: str) -> Path:
        script = scripts / "watch_probes.sh"
        script.write_text(f"#!/bin/sh\nexec {sys.executable} {STEADY} {' '.join(words)}\n")
        script.chmod(0o755)
        file = tmp_path / "target.yml"
        file.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
        return file

    return make


def observe(target, tmp_path, for_s=2):
    status = main(["observe", "--target", str(target), "--for", f"{for_s}s", "--results", str(tmp_path / "results")])
    paths = [path for path in (tmp_path / "results").glob("*/run.json") if not path.parent.name.startswith(".")]
    return status, {path.parent.name: json.loads(path.read_text()) for path in paths}


def check_kept(records, results, for_s=2, least=3):
    """The observation and its messages, with what was asked for and what was seen of it."""
    name = next(name for name in records if "-messages-a-" in name)
    assert len(np.load(results / name / f"{name}.npy")) >= least
    coverage = records["001"]["coverage"]
    assert coverage == records[name]["coverage"] and coverage["asked_ns"] == for_s * 10**9
    assert 0 < coverage["seen_ns"] <= coverage["asked_ns"]
    return coverage


def interrupt(number=signal.SIGINT):
    os.kill(os.getpid(), number)


def once_seen(monkeypatch, *acts, seconds=(1,)):
    """Do each so many seconds after something was first seen."""
    feed, started = FlowAccumulator.feed, []

    def fed(flows, items):
        if not started:
            started.extend(threading.Timer(*timing) for timing in zip(seconds, acts, strict=True))
            for timer in started:
                timer.start()
        return feed(flows, items)

    monkeypatch.setattr(FlowAccumulator, "feed", fed)


def test_all_of_it(target, tmp_path):
    """For the tests below."""
    status, records = observe(target(), tmp_path)
    assert (status, records["001"]["status"]) == (0, "ok"), records["001"]
    assert check_kept(records, tmp_path / "results")["seen_ns"] == 2 * 10**9


@pytest.mark.parametrize("seconds", [(1, 3), (3.5,)], ids=["twice", "late"])
def test_ctrl_c_while_the_probes_are_taken_off(target, tmp_path, monkeypatch, seconds):
    once_seen(monkeypatch, *([interrupt] * len(seconds)), seconds=seconds)
    status, records = observe(target("end", "6"), tmp_path)
    check_kept(records, tmp_path / "results")
    assert status in (0, 130)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal(target, tmp_path, monkeypatch, number):
    once_seen(monkeypatch, lambda: interrupt(number))
    status, records = observe(target(), tmp_path)
    check_kept(records, tmp_path / "results")
    assert (status, records["001"]["status"]) == (0, "ok")


@pytest.mark.parametrize("error", [MemoryError(), OSError(24, "Too many open files"), AssertionError("x")])
@pytest.mark.parametrize("where", [(FlowAccumulator, "feed"), (session.WatchReader, "feed")], ids=["feed", "read"])
def test_a_defect_while_it_is_observed(target, tmp_path, monkeypatch, error, where, capfd):
    """It is kept, and the defect is reported as such."""
    owner, name = where
    method, calls = getattr(owner, name), []

    def fail(*args):
        calls.append(args)
        if len(calls) == 10 or (len(calls) > 10 and isinstance(error, OSError)):
            raise error
        return method(*args)

    monkeypatch.setattr(owner, name, fail)
    status, records = observe(target(), tmp_path)
    check_kept(records, tmp_path / "results", least=1)
    assert status == (3 if isinstance(error, OSError) else 70) and records["001"]["status"] == "incomplete"
    assert type(error).__name__ in records["001"]["reason"]


@pytest.mark.parametrize("name", ["_output", "_write_run"])
def test_a_defect_while_a_stream_is_written(target, tmp_path, monkeypatch, name):
    """The other streams are kept."""
    write, calls = getattr(stream_runs, name), []

    def fail(*args, **more):
        calls.append(args)
        if len(calls) == 2:
            raise ValueError("a number that no record takes")
        return write(*args, **more)

    monkeypatch.setattr(stream_runs, name, fail)
    status, records = observe(target(), tmp_path)
    assert status == 3 and len(records) > 1 and records["001"]["status"] == "incomplete"
    assert "a number that no record takes" in records["001"]["reason"]
    assert records["001"]["coverage"]["seen_ns"] == 2 * 10**9


def test_a_defect_after_it(target, tmp_path, monkeypatch):
    def fail(*_args, **_more):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(run_execution.inspection, "read_state", fail)
    monkeypatch.setattr(run_execution, "_begin", begun_without_state)
    status, records = observe(target(), tmp_path)
    check_kept(records, tmp_path / "results")
    assert status == 3


def begun_without_state(work, now):
    return resumption.without_folder(now().isoformat(), TargetState())


@pytest.mark.parametrize(
    "act",
    [
        shutil.rmtree,
        lambda results: results.rename(results.with_name("elsewhere")),
        lambda results: [path.unlink() for path in results.iterdir() if path.is_file()],
    ],
    ids=["removed", "renamed", "emptied"],
)
def test_a_results_folder_that_goes_away(target, tmp_path, monkeypatch, act):
    once_seen(monkeypatch, lambda: act(tmp_path / "results"))
    status, records = observe(target(), tmp_path)
    check_kept(records, tmp_path / "results")
    assert status == 0


def test_a_results_folder_that_becomes_a_file(target, tmp_path, monkeypatch, capsys):
    """What was observed is kept elsewhere, and the message says where."""

    def act():
        shutil.rmtree(tmp_path / "results")
        (tmp_path / "results").write_text("x")

    once_seen(monkeypatch, act)
    check_kept_elsewhere(target(), tmp_path, monkeypatch, capsys)


def test_a_results_folder_that_becomes_read_only(target, tmp_path, monkeypatch, capsys):
    disk = tmp_path / "results"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=8m,mode=755", "tmpfs", disk]
    if os.geteuid() != 0 or subprocess.run(mount, check=False).returncode != 0:
        pytest.skip("only root can mount")
    try:
        once_seen(monkeypatch, lambda: subprocess.run(["mount", "-o", "remount,ro", disk], check=True))
        check_kept_elsewhere(target(), tmp_path, monkeypatch, capsys)
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


def check_kept_elsewhere(target, tmp_path, monkeypatch, capsys):
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    status, _ = observe(target, tmp_path)
    (kept,) = place.iterdir()
    assert status == 3 and f"kept in {kept}" in capsys.readouterr().err
    check_kept({path.parent.name: json.loads(path.read_text()) for path in kept.glob("*/run.json")}, kept)


@pytest.mark.parametrize("lie", ["locked", "cpus", "name", "same time", "ready"])
def test_a_lie_is_read_as_what_a_record_takes(target, tmp_path, lie):
    """Where it is not, it ends the observation, and not the keeping of it."""
    status, records = observe(target("5", f"'{lie}'"), tmp_path, for_s=3)
    check_kept(records, tmp_path / "results", for_s=3)
    ends = lie in ("locked", "cpus", "ready")
    assert records["001"]["coverage"]["seen_ns"] < 3 * 10**9 or not ends
    assert (status, records["001"]["status"]) == ((3, "incomplete") if ends else (0, "ok")), records["001"]["reason"]
    assert main(["verify", str(tmp_path / "results")]) == 0
    assert main(["report", str(tmp_path / "results"), "--format", "json", "--output", str(tmp_path / "x")]) == 0


@pytest.mark.parametrize("step", [timedelta(days=-1), timedelta(days=-20000), timedelta(days=80000)])
def test_a_clock_of_the_runner_that_is_set(target, tmp_path, monkeypatch, step):
    """Between begin and end. The time that was seen is not of that clock."""
    now, calls = board.utc_now, []

    def jumped():
        calls.append(now() + step * (len(calls) > 1))
        return calls[-1]

    monkeypatch.setattr(board, "utc_now", jumped)
    status, records = observe(target(), tmp_path)
    assert check_kept(records, tmp_path / "results")["seen_ns"] == 2 * 10**9 and status == 0
    assert main(["verify", str(tmp_path / "results")]) == 0


def test_a_runner_that_is_stopped_for_a_while(target, tmp_path):
    """SIGSTOP: this machine's other processes go on."""
    stop = f"sleep 2; kill -STOP {os.getpid()}; sleep 6; kill -CONT {os.getpid()}"
    with subprocess.Popen(["sh", "-c", stop]) as process:
        status, records = observe(target(), tmp_path, for_s=4)
        process.wait()
    check_kept(records, tmp_path / "results", for_s=4)
    assert status == 0


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (FlowAccumulator, "finish"),
        (observation, "coverage"),
        (run_execution, "_end_background"),
        (run_execution, "close"),
        (run_execution.processes, "remove"),
    ],
)
def test_ctrl_c_after_it(target, tmp_path, monkeypatch, owner, name):
    """At each step up to its end."""
    step = getattr(owner, name)

    def interrupted(*args, **more):
        interrupt()
        return step(*args, **more)

    monkeypatch.setattr(owner, name, interrupted)
    status, records = observe(target(), tmp_path, for_s=1)
    check_kept(records, tmp_path / "results", for_s=1, least=1)
    assert status == 130 and not [*(tmp_path / "results").glob(".*")]


LIMITED = """
import resource, sys
sys.path[:0] = {path!r}
from pathlib import Path
from rtrun.execution import observation, system
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.targets import deploy
from hostile.test_observation_ends import PROBES, Placement, main
deploy.ON_TARGET = Path({scripts!r})
observation.watch = lambda *_, **__: observation.Watched(found=(), placement=Placement(probes=PROBES, refused=()))
system.wait_ready = lambda *_, **__: None
feed, calls = FlowAccumulator.feed, []

def fed(flows, items):
    calls.append(feed(flows, items))
    if len(calls) == 6:
        {limit}

FlowAccumulator.feed = fed
sys.exit(main({argv!r}))
"""


@pytest.mark.parametrize(
    "limit",
    [
        "resource.setrlimit(resource.RLIMIT_NOFILE, (24, 24))",
        "resource.setrlimit(resource.RLIMIT_AS, (1, 1)); globals().update(hog=[bytes(1 << 24) for _ in range(10)])",
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))",
        "resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))",
    ],
    ids=["files", "memory", "size of a file", "processes"],
)
def test_a_runner_that_gets_no_more(target, tmp_path, limit):
    file = target()
    argv = ["observe", "--target", str(file), "--for", "2s", "--results", str(tmp_path / "results")]
    code = LIMITED.format(path=sys.path, scripts=str(deploy.ON_TARGET), argv=argv, limit=limit)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=False)
    paths = (tmp_path / "results").glob("[0-9]*/run.json")
    records = {path.parent.name: json.loads(path.read_text()) for path in paths}
    assert "001" in records, (done.returncode, done.stdout[-500:], done.stderr[-3000:])
    check_kept(records, tmp_path / "results")


@pytest.mark.parametrize("how", ["removed", "journal that cannot be written"])
def test_a_campaign_whose_results_folder_goes_away(target, tmp_path, monkeypatch, how):
    file, results = target(), tmp_path / "results"
    runs = {"schema": 1, "name": "own", "for": "2s", "subject": "attached", "runs": [{"sampler": "none"}]}
    (tmp_path / "own.yml").write_text(json.dumps(runs))

    def fail(*_):
        raise InfrastructureError("the journal: cannot keep the results: disk I/O error")

    if how == "removed":
        once_seen(monkeypatch, lambda: shutil.rmtree(results))
    else:
        once_seen(monkeypatch, lambda: monkeypatch.setattr(Journal, "note", fail))
    main(["run", str(tmp_path / "own.yml"), "--target", str(file), "--results", str(results)])
    records = {path.parent.name: json.loads(path.read_text()) for path in results.glob("[0-9]*/run.json")}
    (name,) = [name for name in records if records[name]["suite"] == "observation"]
    check_kept({**records, "001": records[name]}, results)


class Endless:
    """A link to a target that prints more than anybody takes: 2 000 pieces, of which the first cannot be read."""

    def __init__(self):
        self.address = "a target"
        self.shell = self
        self.is_interrupted = False

    def do(self, call):
        call(self)

    def execute(self, argv, stdin, take, deadline_s, feed):
        for _ in range(2000):
            if self.is_interrupted:
                break
            take(b"nonsense\n")
            feed()
        return 0, ""

    def interrupt(self):
        self.is_interrupted = True


def test_what_nobody_takes_any_more_does_not_hold_the_target():
    """A busy target may have a minute of events to print when its observation ends."""
    link = Endless()
    stream = session.observe(link, PurePosixPath("/x"), Placement(probes=PROBES, refused=()), (), for_s=60)
    with pytest.raises(TargetError, match="nonsense"):
        next(stream)
    assert not link.is_interrupted
