"""What was observed is kept, whatever ends the observation, and its record tells what was not seen.

Each ends one that asked for 8 s after some rounds, on real programs with real probes.
"""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from probes.standin import SCRIPTS, build, left, running, skip_without_trace, wait_until_nothing_is_left
from proxy import proxy_to

from rtrun.cli import main
from rtrun.execution import observation, observed_runs, run_execution
from rtrun.flows.live import LiveFigures
from rtrun.probes import session
from rtrun.targets import deploy
from rtrun.targets.errors import ConnectionLost
from rtrun.targets.link import TargetRebooted

pytestmark = [pytest.mark.trace, pytest.mark.timeout(180)]
S = 10**9
ASKED_S = 8
# Of this process alone: what others publish on this machine is observed as well.
TOPIC = f"kept{os.getpid()}"


@pytest.fixture(scope="module")
def standin(tmp_path_factory):
    """A program to observe, 500 messages a second."""
    skip_without_trace()
    with running(build(tmp_path_factory.mktemp("standin")), 500, 10**9, 4 * 10**15, 1000, f"/{TOPIC}") as process:
        yield process


@pytest.fixture(autouse=True)
def _nothing_stays(standin):
    """Whatever ended it. What a watchdog takes off on a busy machine may outlast its rtrun."""
    yield
    wait_until_nothing_is_left()


@pytest.fixture(params=["local", "sshd"])
def address(request, sshd, tmp_path):
    """How a target file reaches this machine."""
    if request.param == "local":
        yield "kind: local\n"
        return
    lines = [
        "kind: ssh",
        "host: 127.0.0.1",
        f"port: {sshd.port}",
        f"user: {sshd.user}",
        f"key: {sshd.key}",
        f"host_key: {sshd.host_key}",
    ]
    yield "\n".join(lines) + "\n"


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(session, "QUIET_S", 3.0)
    monkeypatch.setattr(session, "TAKE_OFF_S", 4.0)
    monkeypatch.setattr(session, "END_S", 5.0)


def observe(tmp_path, address, standin, *more, act=None, results=None):
    """Observe, and `act` when two seconds were seen, with the pid of the watchdog; returns exit status and records."""
    target = tmp_path / "target.yml"
    target.write_text(f"schema: 1\nname: here\n{address}work_dir: {tmp_path}/work\n")
    results = results or tmp_path / "results"

    def wait_and_act():
        before = set(left())
        while not (new := [name for name in left() if name.startswith("rtrun-observe-") and name not in before]):
            time.sleep(0.1)
        assert is_seen.wait(60)
        act(int(new[0].split("_")[-2]))

    is_seen, snapshot = threading.Event(), LiveFigures.snapshot

    def watch(figures, at_ns):
        if at_ns > figures._observed.begin_ns + 2 * S:
            is_seen.set()
        return snapshot(figures, at_ns)

    thread = threading.Thread(target=wait_and_act, daemon=True)
    if act:
        thread.start()
    argv = ["observe", "--target", str(target), "--for", f"{ASKED_S}s", "--results", str(results), *more]
    with mock.patch.object(LiveFigures, "snapshot", watch):
        status = main(argv)
    if act:
        thread.join(30)
    records = {path.parent.name: json.loads(path.read_text()) for path in results.glob("*/run.json")}
    return status, records


def of_stream(records, results, kind="messages"):
    """The record and samples of the stand-in's stream; others may run on this machine."""
    (name,) = [name for name in records if f"-{kind}-{TOPIC}-standin" in name]
    return records[name], np.load(results / name / f"{name}.npy")


def causes_of(record):
    return {gap["cause"] for gap in record["coverage"]["gaps"]}


def check_kept(records, results):
    """The observation and its stream hold the same coverage, and the stream has as many messages as were seen."""
    stream, rows = of_stream(records, results)
    coverage = records["001"]["coverage"]
    assert stream["coverage"] == coverage and coverage["asked_ns"] == ASKED_S * S
    assert 2 * S < coverage["seen_ns"] < ASKED_S * S
    assert len(rows) > 100  # of 500 a second, on a machine that may be busy
    assert " of 8 s were seen, with " in records["001"]["reason"]
    return stream, coverage


def test_all_of_it(tmp_path, address, standin):
    """For the tests below: one that nothing ends has seen what it was asked for."""
    status, records = observe(tmp_path, address, standin)
    stream, rows = of_stream(records, tmp_path / "results")
    assert (status, records["001"]["status"], stream["status"]) == (0, "ok", "ok")
    assert stream["coverage"]["asked_ns"] == ASKED_S * S and len(rows) > 500
    assert "ended early" not in causes_of(stream) and "watchdog silent" not in causes_of(stream)


def test_a_stopped_watchdog(tmp_path, address, standin, impatient):
    """It does not end, and prints no more. Another one is started, and what lies between is a gap."""
    groups = []

    def stop(pid):
        groups.append(os.getpgid(pid))
        os.killpg(groups[0], signal.SIGSTOP)

    begin_s = time.monotonic()
    try:
        status, records = observe(tmp_path, address, standin, act=stop)
    finally:
        for group in groups:
            os.killpg(group, signal.SIGCONT)
    assert time.monotonic() - begin_s < 60
    stream, coverage = check_kept(records, tmp_path / "results")
    assert status == 0 and "watchdog silent" in causes_of(stream) and stream["status"] == "ok"
    (gap,) = [gap for gap in coverage["gaps"] if gap["cause"] == "watchdog silent"]
    assert gap["end_ns"] - gap["begin_ns"] > 2 * S


def test_a_killed_watchdog(tmp_path, address, standin, impatient):
    """What was killed cannot take the probes off: a remark reports that, and the next call does it."""
    status, records = observe(tmp_path, address, standin, act=lambda pid: os.killpg(os.getpgid(pid), signal.SIGKILL))
    check_kept(records, tmp_path / "results")
    assert (status, records["001"]["status"]) == (3, "incomplete")
    assert "was ended there by signal 9" in records["001"]["reason"]
    assert causes_of(records["001"]) >= {"ended early"}
    graph = json.loads((tmp_path / "results/001/graph.json").read_text())
    assert "the probes were not seen to be taken off: the next call takes off what is left" in graph["remarks"]
    observe(tmp_path, address, standin, results=tmp_path / "again")


def test_a_killed_printer(tmp_path, standin):
    """The watchdog lives, and takes the probes off; what was not printed was not seen."""

    def children_of(pid):
        try:
            return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        except OSError:
            return []

    def kill_printer(pid):
        # Of what the script has started it alone starts something in turn: it sleeps between two rounds.
        while not (printers := [child for child in children_of(pid) if children_of(child)]):
            time.sleep(0.01)
        os.kill(int(printers[0]), signal.SIGKILL)

    status, records = observe(tmp_path, "kind: local\n", standin, act=kill_printer)
    check_kept(records, tmp_path / "results")
    assert (status, records["001"]["status"]) == (3, "incomplete")
    assert "what prints the events on the target was ended there" in records["001"]["reason"]
    graph = json.loads((tmp_path / "results/001/graph.json").read_text())
    assert not [remark for remark in graph["remarks"] if "taken off" in remark], "they were"
    assert causes_of(records["001"]) >= {"ended early"}


def test_a_link_that_is_lost_for_good(tmp_path, sshd, standin):
    with proxy_to(sshd.port) as proxy:
        address = "\n".join(
            [
                "kind: ssh",
                "host: 127.0.0.1",
                f"port: {proxy.port}",
                f"user: {sshd.user}",
                f"key: {sshd.key}",
                f"host_key: {sshd.host_key}",
                "reconnect_s: 1",
                "",
            ]
        )
        status, records = observe(tmp_path, address, standin, act=lambda _: proxy.cut())
    check_kept(records, tmp_path / "results")
    assert (status, records["001"]["status"]) == (3, "incomplete")


@pytest.mark.parametrize(
    ("lie", "reason"),
    [
        ('echo "a lie"', "unexpected line 'a lie'"),
        ('echo "round 0"', "cannot be read"),
        ("echo rtrun end done; kill -KILL 0", "was ended there by signal 9"),
    ],
)
def test_a_lying_target(tmp_path, standin, monkeypatch, impatient, lie, reason):
    scripts = tmp_path / "lying"
    scripts.mkdir()
    for path in Path(str(SCRIPTS)).glob("*"):
        if path.is_file():
            (scripts / path.name).write_bytes(path.read_bytes())
            (scripts / path.name).chmod(0o755)
    honest = (scripts / "watch_probes.sh").read_text()
    place = '        mark "round $number"\n'
    assert place in honest
    (scripts / "watch_probes.sh").write_text(
        honest.replace(place, f"{place}        [ $number -ne 5 ] || {{ {lie}; }}\n")
    )
    monkeypatch.setattr(deploy, "ON_TARGET", scripts)
    status, records = observe(tmp_path, "kind: local\n", standin)
    check_kept(records, tmp_path / "results")
    assert (status, records["001"]["status"]) == (3, "incomplete") and reason in records["001"]["reason"]
    monkeypatch.undo()
    observe(tmp_path, "kind: local\n", standin, results=tmp_path / "again")


def test_a_disk_of_the_runner_that_has_no_room_for_all(tmp_path, standin, monkeypatch):
    """The streams that fit are kept, and the others are named."""
    monkeypatch.setattr(observed_runs, "_ROOM_BYTES", 2**18)
    disk = tmp_path / "disk"
    disk.mkdir()
    # Room for what tells of it, and for some of the streams: 500 rows of a second are 16 kB of each.
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k,mode=755", "tmpfs", disk], check=True)
    try:
        status, records = observe(tmp_path, "kind: local\n", standin, results=disk)
        assert (status, records["001"]["status"]) == (3, "incomplete")
        assert "cannot keep the results" in records["001"]["reason"]
        assert len(records) > 1, records["001"]["reason"]
        assert records["001"]["coverage"]["asked_ns"] == ASKED_S * S
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


def test_ctrl_c(tmp_path, standin):
    status, records = observe(tmp_path, "kind: local\n", standin, act=lambda _: os.kill(os.getpid(), signal.SIGINT))
    stream, _ = check_kept(records, tmp_path / "results")
    assert (status, stream["status"], causes_of(stream) >= {"ended early"}) == (0, "ok", True)


def test_a_disk_that_others_fill_meanwhile(tmp_path, standin, monkeypatch, capsys):
    """Room for what tells of the observation itself is kept from the beginning."""
    monkeypatch.setattr(observed_runs, "_ROOM_BYTES", 2**18)
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m,mode=755", "tmpfs", disk], check=True)

    def fill(_pid):
        with contextlib.suppress(OSError), (disk / "of others").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass

    try:
        status, records = observe(tmp_path, "kind: local\n", standin, act=fill, results=disk)
        # How many streams fit is up to how many messages came.
        reason = records["001"]["reason"]
        assert status == 3 and re.search(r"\d streams? not kept: .*cannot keep the results", reason), reason
        assert records["001"]["status"] == "incomplete"
        assert records["001"]["coverage"]["seen_ns"] > 2 * S
        # A disk that is full already is reported before anything is observed.
        capsys.readouterr()
        status, again = observe(tmp_path, "kind: local\n", standin, results=disk)
        assert (status, again) == (3, records) and not [*disk.glob(".*")]
        printed = capsys.readouterr()
        assert f"{disk}: cannot keep the results: No space left on device" in printed.err and "0 s" not in printed.out
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_while_it_is_kept(tmp_path, standin, monkeypatch, times, capfd):
    """The first one waits until it is; the second one does not."""
    write_streams = observed_runs.write_streams

    def interrupted(*args, **more):
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)
        return write_streams(*args, **more)

    monkeypatch.setattr(observed_runs, "write_streams", interrupted)
    status, records = observe(tmp_path, "kind: local\n", standin)
    assert status == 130 and observation.KEPT_FIRST in capfd.readouterr().err
    assert [records[name]["status"] for name in records if name == "001"] == ["ok"] * (times == 1)
    assert len(records) > 1 or not records
    assert not [*(tmp_path / "results").glob(".*")]


def campaign(tmp_path):
    """The words for a campaign of one observation; nobody attends it."""
    (tmp_path / "target.yml").write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
    runs = {"schema": 1, "name": "own", "for": f"{ASKED_S}s", "subject": "attached", "runs": [{"condition": "idle"}]}
    (tmp_path / "own.yml").write_text(json.dumps(runs))
    results = str(tmp_path / "results")
    return ["run", str(tmp_path / "own.yml"), "--target", str(tmp_path / "target.yml"), "--results", results]


def ended_once(monkeypatch, error):
    """Let this end the first observation, after some seconds."""
    observe_all, ends = session.observe, [error]

    def observed(*args, **more):
        for number, item in enumerate(stream := observe_all(*args, **more)):
            yield item
            if number == 4 and ends:
                stream.close()
                raise ends.pop()

    monkeypatch.setattr(session, "observe", observed)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), TargetRebooted("here: the target was restarted")])
def test_a_campaign_keeps_what_was_seen_and_observes_again(tmp_path, standin, monkeypatch, error):
    """At once after a restart of the target; with the next call after Ctrl-C."""
    ended_once(monkeypatch, error)
    words = campaign(tmp_path)
    if isinstance(error, KeyboardInterrupt):
        assert main(words) == 130
    assert main(words) == 0
    records = {path.parent.name: json.loads(path.read_text()) for path in tmp_path.glob("results/*/run.json")}
    first, again = records["001-observation.old-1"], records["001-observation"]
    assert (first["status"], again["status"]) == ("incomplete", "ok")
    assert ("was interrupted" if isinstance(error, KeyboardInterrupt) else "was restarted") in first["reason"]
    assert S < first["coverage"]["seen_ns"] < again["coverage"]["seen_ns"] and "ended early" in causes_of(first)
    (name,) = (name for name in records if f"-messages-{TOPIC}-standin" in name and ".old-" in name)
    assert records[name]["coverage"] == first["coverage"] and records[name]["status"] == "ok"
    assert not [*(tmp_path / "work/runs").glob("*")]


@pytest.mark.parametrize("step", ["_end_background", "processes.remove"])
def test_trouble_after_it_takes_nothing_away(tmp_path, standin, monkeypatch, step):
    def fail(*_args, **_more):
        raise ConnectionLost("127.0.0.1: the connection broke")

    owner, _, name = step.rpartition(".")
    monkeypatch.setattr(run_execution.processes if owner else run_execution, name, fail)
    status, records = observe(tmp_path, "kind: local\n", standin)
    assert (status, records["001"]["status"]) == (0, "ok")
    assert len(of_stream(records, tmp_path / "results")[1]) > 500


def test_a_picture_that_finds_no_room(tmp_path, standin):
    """It is written once the runs are kept."""
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k,mode=755", "tmpfs", disk], check=True)
    try:
        status, records = observe(tmp_path, "kind: local\n", standin, "--perfetto", str(disk / "trace"))
    finally:
        subprocess.run(["umount", "-l", disk], check=True)
    assert status != 0 and records["001"]["status"] == "ok"


TWO = """
import sys
sys.path[:0] = {path!r}
from rtrun.cli import main
sys.exit(main({argv!r}))
"""


def test_two_observers_of_one_folder(tmp_path, standin):
    """Each has a number of its own, and nothing of either is put aside."""
    target = tmp_path / "target.yml"
    target.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
    results = tmp_path / "results"
    argv = ["observe", "--target", str(target), "--for", "4s", "--results", str(results)]
    code = TWO.format(path=sys.path, argv=argv)
    started = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    outputs = [process.communicate(timeout=120)[0] for process in started]
    assert [process.returncode for process in started] == [0, 0, 0], outputs
    names = sorted(path.name for path in results.iterdir())
    assert [name for name in names if name.isdecimal()] == ["001", "002", "003"], names
    assert not [name for name in names if ".old-" in name or name.startswith(".")], names
    for number in ("001", "002", "003"):
        assert [name for name in names if name.startswith(f"{number}-messages-{TOPIC}-standin")], names


IN_A_CONTAINER = """
import subprocess, sys
sys.path[:0] = {path!r}
from rtrun.cli import main
with subprocess.Popen({standin!r}, stdout=subprocess.PIPE) as process:
    try:
        status = main({argv!r})
    finally:
        process.kill()
sys.exit(status)
"""


def test_in_a_namespace_of_pids_it_is_told_how_to_start_the_container(tmp_path, standin):
    """The kernel records pids that nobody in there can tell: nothing is placed, and no stream is made of them."""
    target = tmp_path / "target.yml"
    target.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
    argv = ["observe", "--target", str(target), "--for", "3s", "--results", str(tmp_path / "results")]
    code = IN_A_CONTAINER.format(path=sys.path, argv=argv, standin=standin.args)
    unshare = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc", sys.executable, "-c", code]
    before = set(left())
    run = subprocess.run(unshare, capture_output=True, text=True, timeout=120)
    assert run.returncode == 3 and "start the container with --pid=host" in run.stderr, run
    assert list((tmp_path / "results").iterdir()) == [] and set(left()) <= before


def test_programs_of_a_container_are_observed_from_the_host(tmp_path, standin):
    """They have other pids in there: the streams have their names, and the pids of the host."""
    argv = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc", *standin.args[:-1], "/contained"]
    with running(*argv) as process:
        _, records = observe(tmp_path, "kind: local\n", standin)
        (name,) = [name for name in records if "-messages-contained-" in name]
        (program,) = records[name]["programs"]
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        assert [str(program["pid"])] == children
    assert not [name for name in records if "thread" in name or "process" in name]
