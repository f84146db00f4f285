"""Campaigns that observe: what a command starts is started, waited for, observed under a load, and ended."""

import contextlib
import json
import os
import re
import sqlite3
import sys
import time
from pathlib import Path

import pytest
from probes.standin import build, running, skip_without_trace

from rtrun.cli import main
from rtrun.execution import observation, system
from rtrun.flows.live import LiveFigures

pytestmark = pytest.mark.trace
RTRUN = [sys.executable, "-c", "import sys; from rtrun.cli import main; sys.exit(main(sys.argv[1:]))"]


@pytest.fixture(scope="session")
def standin(tmp_path_factory):
    return build(tmp_path_factory.mktemp("observed"))


@pytest.fixture
def folder(tmp_path):
    skip_without_trace()
    (tmp_path / "here.yml").write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
    return tmp_path


def call(folder, campaign):
    text = {"schema": 1, "name": "own", "for": "2s", "runs": [{"condition": "idle"}]} | campaign
    (folder / "own.yml").write_text(json.dumps(text))
    return ["run", str(folder / "own.yml"), "--target", str(folder / "here.yml"), "--results", str(folder / "results")]


def records(folder):
    return {path.parent.name: json.loads(path.read_text()) for path in folder.glob("results/*/run.json")}


def marked(folder):
    """The processes that were started for a campaign, by what they run: each is in a control group of its program."""
    found = {}
    for known_by in (folder / "work/runs").glob("*/*/*.known_by"):
        for procs in Path(known_by.read_text().strip()).rglob("cgroup.procs"):
            for pid in procs.read_text().split():
                with contextlib.suppress(OSError):
                    found[int(pid)] = Path(f"/proc/{pid}/cmdline").read_bytes()
    return found


@pytest.mark.parametrize(
    ("start", "ready", "reason"),
    [
        ("exec {standin}-2 200 10", None, "ended before the system was ready, with exit status 127: .*not found"),
        ("sleep 1; echo no robot here >&2; exit 4", "topic /a", "ready, with exit status 4: no robot here"),
        ("exec sleep 600", "topic /a", "waited 2 s for a program .* has started none that uses ROS 2 or roscpp"),
        ("exec {standin} 200 999999", "topic /b", "waited 2 s for the system to publish /b: seen were /a"),
        ("timeout 8 {standin} 200 999999; exit 5", "topic /a", "ended while it was observed, with exit status 5"),
    ],
)
def test_what_does_not_come_up_or_does_not_stay_is_said(folder, standin, monkeypatch, start, ready, reason, capsys):
    monkeypatch.setattr(system, "READY_S", 20.0 if "timeout" in start else 2.0)
    monkeypatch.setattr(observation, "GONE_NS", 10**9)
    subject = {"start": start.format(standin=standin)} | ({"ready": ready} if ready else {})
    assert main(call(folder, {"subject": subject, "for": "60s"})) == 3, capsys.readouterr()
    record = records(folder)["001-observation"]
    assert record["status"] == "failed"
    assert re.search(reason, record["reason"]), record["reason"]
    assert marked(folder) == {}


@pytest.mark.parametrize(
    ("then", "how"),
    [("exit 5", "with exit status 5"), ("kill -KILL $PPID; sleep 600", "killed from outside"), ("exit 0", None)],
)
def test_what_it_leaves_running_does_not_hide_how_it_ended(folder, standin, monkeypatch, then, how, capsys):
    """Nor that nobody watches over it any more. A command that ended well may have started the system and gone."""
    real = LiveFigures.snapshot

    def snapshot(*words):
        (folder / "observed").touch()
        return real(*words)

    monkeypatch.setattr(LiveFigures, "snapshot", snapshot)
    start = f"{standin} 200 999999 & until [ -e {folder}/observed ]; do sleep 0.1; done; {then}"
    status = main(call(folder, {"subject": {"start": start, "ready": "topic /a"}, "for": "5s"}))
    record = records(folder)["001-observation"]
    if how is None:
        assert (status, record["status"]) == (0, "ok"), capsys.readouterr()
    else:
        assert (status, record["status"]) == (3, "failed"), capsys.readouterr()
        assert f"the system ended while it was observed, {how}: " in record["reason"]
    assert marked(folder) == {}


@pytest.mark.ros
def test_a_pair_under_a_load_is_killed_and_gone_on_with(folder, suites, ros_master):
    """What is done is not measured again, what was interrupted is; what others started is left alone."""
    programs = suites / "lib" / "communication_tests"
    options = f"-r 1000000 -f 200 --out-dir {folder} /communication_tests:=/own"
    master = f"ROS_MASTER_URI=http://127.0.0.1:{ros_master} ROS_IP=127.0.0.1"
    start = (
        f"export {master}; {programs}/communication_tests_subscriber {options} --idle-timeout 600 & "
        f"exec setsid {programs}/communication_tests_publisher {options} -d 1"
    )
    campaign = {
        "subject": {"start": start, "ready": "topic /own"},
        "deadlines": ["/own=1s"],
        "runs": [{"condition": "cpu80", "repeats": 2}],
    }
    words = call(folder, campaign)
    own = dict(os.environ) | dict(word.split("=", 1) for word in master.split())
    stranger = [programs / "communication_tests_subscriber", "-r", "9", "--idle-timeout", "600", "__name:=stranger"]
    with running(*stranger, env=own, cwd=folder) as other:
        with running(*RTRUN, *words) as runner:
            await_state(folder, "002-observation-cpu80-r2", "observing", runner)
            runner.kill()
        left = set(marked(folder))
        assert len(left) > 1, "nobody was there to end them"
        first = (folder / "results/001-observation-cpu80/run.json").stat().st_mtime_ns
        assert main(words) == 0
        assert (folder / "results/001-observation-cpu80/run.json").stat().st_mtime_ns == first
        assert marked(folder) == {} and other.poll() is None
    seen = records(folder)
    assert {name for name, record in seen.items() if record["status"] != "ok"} == set()
    for name in ("001-observation-cpu80", "002-observation-cpu80-r2"):
        streams = [record for record in seen.values() if record.get("observed_by") == name]
        (messages,) = (
            stream for stream in streams if stream["suite"] == "observed_messages" and "deadline_ns" in stream
        )
        assert messages["condition"] == "cpu80" and messages["in_effect"]["loads"]["stress"] > 1
        assert messages["parameters"]["topic"] == "/own" and messages["deadline_ns"] == 10**9
        assert all(program["threads"] for program in messages["programs"])
        assert (folder / "results" / name / "graph.json").is_file()
    assert main(["verdict", str(folder / "results"), "--probability", "0.1"]) == 0
    assert main(words) == 0, "nothing is left to do"


def await_state(folder, run, state, runner):
    deadline = time.monotonic() + 240
    while runner.poll() is None and time.monotonic() < deadline:
        journal = folder / "results/journal.sqlite"
        # It is being made.
        with contextlib.suppress(sqlite3.OperationalError):
            query = "SELECT 1 FROM event WHERE run = ? AND what = ?"
            if journal.exists() and sqlite3.connect(journal).execute(query, (run, state)).fetchone():
                time.sleep(1)
                return
        time.sleep(0.1)
    raise AssertionError(f"{run} was not {state}")


@pytest.mark.parametrize(
    ("deadlines", "status", "answers", "rounds"),
    [
        (["interval:/a=50s"], 0, {"PROVEN"}, 1),
        (["interval:/a=1us"], 0, {"REFUTED"}, 1),
        (["interval:/nobody=1s"], 3, set(), 3),
    ],
)
def test_what_runs_already_is_observed_until_it_is_decided(folder, standin, deadlines, status, answers, rounds, capsys):
    words = [word for deadline in deadlines for word in ("--deadline", deadline)]
    here, results = str(folder / "here.yml"), str(folder / "results")
    goal = ["--until", "probability=0.2,at_most=10min", "--for", "2s", "--results", results]
    with running(standin, 200, 999999) as process:
        assert main(["observe", "--target", here, *words, *goal]) == status, capsys.readouterr()
        assert process.poll() is None
    printed = capsys.readouterr().out
    if status:
        assert "interval /nobody: it was not seen; seen were /a" in printed
    assert json.loads((folder / "results/goal.json").read_text())["until"]["probability"] == 0.2
    events = sqlite3.connect(f"{results}/journal.sqlite").execute("SELECT what FROM event WHERE what = 'observing'")
    # On a busy machine values depend on one another, and an answer takes more of them.
    number = len(events.fetchall())
    assert number == rounds if status else number >= rounds
    main(["verdict", results, "--json"])
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert {group["answer"] for group in groups} - {"no deadline"} == answers
