"""`rtrun quick` on this machine: without any file, from what it finds to a first answer, and files to go on from."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from rtrun.cli import main
from rtrun.plan.quick import PRIORITY
from rtrun.results.record import RunStatus, read_record

# It may use the trace of this machine's kernel.
pytestmark = [pytest.mark.ros, pytest.mark.trace]


@pytest.fixture
def quick(tmp_path, monkeypatch, capsys):
    """Call it in an empty folder; returns its status, what it printed, and the errors."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        status = main(["quick", *map(str, words)])
        return status, *capsys.readouterr()

    return call


def kept_from_its_rate(results):
    """The suites whose programs a busy machine kept from their rate: these runs do not count, and the report says why.

    No run may lack anything else.
    """
    records = [read_record(path.parent) for path in results.glob("*/run.json")]
    bad = [record for record in records if record.status is not RunStatus.OK]
    assert all(re.search(r"asked for \d+ Hz, achieved", record.reason or "") for record in bad), bad
    return {record.suite for record in bad}


@pytest.mark.root
def test_a_first_answer_needs_no_file_and_leaves_those_to_go_on_from(quick, suites, tmp_path):
    status, printed, _ = quick("--deadline", "60s", "--for", "6s", "--suites", suites)
    late = kept_from_its_rate(tmp_path / "results" / "quick")
    assert status == (3 if late else 0), printed
    (heading,) = [line for line in printed.splitlines() if line.endswith(" How many are late, 95 % sure:")]
    measured = set(
        re.findall(r"^(\w+)(?: not traced| traced above \w+)? +none of [0-9 ]+ late, ", printed.split(heading)[1], re.M)
    )
    wanted = {"cyclic_timer", "oneshot_timer", "communication"}
    assert measured >= wanted - {name.removesuffix("_tests") for name in late}
    assert all(re.search(rf"^not analysed: .*{name}", printed, re.M) for name in wanted - measured), printed
    assert ("cyclictest" in measured) == (shutil.which("cyclictest") is not None)
    # Beside other tests a row may not stay the same, or skip periods: then no rate is claimed.
    answers = " ".join(printed.split(heading)[1].split())
    follows = ": (?:at most|no upper limit can be given: |the system changed |probably more than )"
    assert answers.count("none of ") == len(re.findall(follows, answers)), printed
    assert "\nAt most 1 in 100 late? " in printed and "\nAt most 1 in a million late? " in printed
    assert "in the way of real time: " in printed
    results = tmp_path / "results" / "quick"
    assert main(["plan", str(results / "campaign.yml")]) == 0
    assert main(["probe", "--target", str(results / "target.yml")]) == 0
    # Once more keeps what was measured. A target file is used where it lies: its paths are relative to its folder.
    (tmp_path / "boards").mkdir()
    (tmp_path / "built").symlink_to(suites)
    (tmp_path / "boards" / "here.yml").write_text("{schema: 1, name: here, kind: local, suites: ../built}\n")
    words = ["--target", "boards/here.yml", "--suite", "oneshot_timer_tests"]
    status, printed, _ = quick("--deadline", "1ms", "--for", "1s", *words)
    late = kept_from_its_rate(tmp_path / "results" / "quick-2")
    assert status == (3 if late else 0), printed
    assert printed.endswith("report: results/quick-2/report.html\n")
    assert late or "P = 0.01, asked for" in (tmp_path / "results/quick-2/report.html").read_text()
    assert (tmp_path / "results/latest").readlink().name == "quick-2"
    assert "--target boards/here.yml --fresh" in printed
    assert not (tmp_path / "results" / "quick-2" / "target.yml").exists()
    runs = {path.parent.name.partition("_l")[0] for path in tmp_path.glob("results/quick-2/*/run.json")}
    assert runs <= {f"{number:03}-oneshot_timer_tests" for number in (1, 2)} and runs


@pytest.mark.root
def test_without_ros_it_measures_over_shared_memory_and_sockets(quick, suites, tmp_path):
    """As on an image without ROS, whose only suite is that of messages."""
    bare = tmp_path / "bare"
    shutil.copytree(suites, bare, symlinks=True)
    for folder in (bare / "lib").iterdir():
        if folder.is_dir() and folder.name not in ("transport_tests", "rt_tests_sampler"):
            shutil.rmtree(folder)
    status, printed, errors = quick("--deadline", "60s", "--for", "5s", "--suites", bare)
    late = kept_from_its_rate(tmp_path / "results" / "quick")
    assert status == (3 if late else 0), printed + errors
    runs = yaml.safe_load((tmp_path / "results/quick/campaign.yml").read_text())["runs"]
    (messages,) = [run for run in runs if run["suite"] != "cyclictest"]
    assert messages["middleware"] == ["futex", "unix", "tcp", "udp"]
    records = [read_record(path.parent) for path in (tmp_path / "results" / "quick").glob("*/run.json")]
    through = {record.parameters["middleware"] for record in records if record.suite == "communication_tests"}
    assert through == set(messages["middleware"])


@pytest.mark.root
def test_without_a_deadline_it_prints_figures_and_how_to_ask(quick, suites, tmp_path):
    words = ["--for", "2s", "--suites", suites, "--suite", "cyclic_timer_tests"]
    _, printed, _ = quick(*words)
    if not kept_from_its_rate(tmp_path / "results" / "quick"):
        assert re.search(r"^cyclic_timer +1 \d+ +[\d.]+ [mun]s", printed, re.M), printed
    assert "without a deadline there are figures and no answer: ask with --deadline TIME" in printed
    assert printed.endswith("report: results/quick/report.html\n")
    assert not re.search("P\\(|400 us|PROVEN|misses", printed), printed
    _, printed, _ = quick(*words, "--json")
    data = json.loads(printed)
    assert data["deadline_ns"] is None and all(group["p_below"] is None for group in data["groups"])
    assert all(group["worst_ns"] > 0 for group in data["groups"])


@pytest.mark.root
def test_while_another_run_traces_it_measures_without(quick, suites, tmp_path):
    instance, owner = Path("/sys/kernel/tracing/instances/rtrun"), Path("/run/rtrun-trace-of")
    instance.mkdir()
    # As trace.sh notes it for the campaign of another directory.
    owner.write_text("/another\n")
    try:
        _, printed, errors = quick(
            "--deadline", "60s", "--for", "2s", "--suites", suites, "--suite", "oneshot_timer_tests"
        )
    finally:
        instance.rmdir()
    assert "measures without the kernel's trace of late values: another run uses it" in errors
    (run,) = yaml.safe_load((tmp_path / "results/quick/campaign.yml").read_text())["runs"]
    assert "trace" not in run and "How many are late" in printed


@pytest.mark.root
def test_programs_get_the_same_as_json(quick, suites, tmp_path):
    words = ["--for", "2s", "--suites", suites, "--suite", "cyclic_timer_tests", "--json"]
    _, printed, _ = quick("--deadline", "60s", *words)
    data = json.loads(printed)
    assert {"schema", "platform", "results", "deadline_ns", "in_the_way", "why_late", "left_out"} < data.keys()
    assert (data["results"], data["deadline_ns"]) == ("results/quick", 60 * 10**9)
    kept_from_its_rate(tmp_path / "results" / "quick")
    assert len(data["groups"]) == [*data["runs"].values()].count("ok") <= len(data["runs"]) != 0
    for group in data["groups"]:
        assert group["n"] > 0 and (group["p_below"] is None) == (group["no_p"] is not None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--suite", "cyclic"], "--suite cyclic: not there through roscpp, found: "),
        (["--suite", "oneshot_timer_tests", "--middleware", "rcl"], "not there through rcl, found: "),
        (["--target", "none.yml"], "none.yml: "),
        (["--target", "a.yml", "--suites", "there"], "--suites: a target file names them itself"),
        (["--target", "root@"], "--target root@: 'root@' is not [USER@]HOST[:PORT]; a target file ends in .yml"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_measured(quick, suites, tmp_path, words, message):
    given = [] if "--target" in words else ["--suites", suites]
    status, _, errors = quick("--deadline", "1ms", *given, *words)
    assert status == 2 and message in errors
    assert not (tmp_path / "results").exists()


def test_where_the_suites_are_not_it_says_what_makes_them(quick):
    _, _, errors = quick("--deadline", "1ms", "--suite", "none")
    assert "rtgen suites build" in errors


NO_RIGHT = ("prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
THE_RIGHT = f"the right to real-time priority {PRIORITY} (root, or rtprio in /etc/security/limits.conf)"


def as_ordinary_user(folder, *words):
    """Call it as one who may not start real-time programs."""
    argv = [*NO_RIGHT, Path(sys.executable).with_name("rtrun"), "quick", "--deadline", "60s", *map(str, words)]
    return subprocess.run(argv, cwd=folder, capture_output=True, text=True, check=False)


def test_an_ordinary_user_measures_what_he_may(suites, tmp_path):
    done = as_ordinary_user(tmp_path, "--for", "3s", "--suites", suites)
    late = kept_from_its_rate(tmp_path / "results" / "quick")
    assert done.returncode == (3 if late else 0), done.stdout + done.stderr
    planned = yaml.safe_load((tmp_path / "results/quick/campaign.yml").read_text())
    assert planned["common"] == {"policy": "0"}
    assert {run["suite"] for run in planned["runs"]} == {
        "cyclic_timer_tests", "oneshot_timer_tests", "communication_tests",
    }  # fmt: skip
    left_out = " and without cyclictest" if shutil.which("cyclictest") else ""
    note = f"rtrun: measures without a real-time policy{left_out}: this user has not {THE_RIGHT}\n"
    assert note in done.stderr


@pytest.mark.root
def test_the_line_that_it_prints_measures_the_rest(suites, tmp_path):
    done = as_ordinary_user(tmp_path, "--for", "3s", "--suites", suites)
    (line,) = re.findall(
        r"^to measure with real-time priorities, and trace late values: sudo (/.*)$", done.stdout, re.M
    )
    done = subprocess.run(shlex.split(line), cwd=tmp_path, capture_output=True, text=True, check=False)
    late = kept_from_its_rate(tmp_path / "results/quick-2")
    assert done.returncode == (3 if late else 0), done.stdout + done.stderr
    assert yaml.safe_load((tmp_path / "results/quick-2/campaign.yml").read_text())["common"] == {"policy": "FIFO"}
    assert "sudo" not in done.stdout


@pytest.mark.skipif(shutil.which("cyclictest") is None, reason="cyclictest is not installed")
def test_an_ordinary_user_without_suites_is_told_both_ways(tmp_path):
    done = as_ordinary_user(tmp_path)
    assert done.returncode == 3 and not (tmp_path / "results").exists()
    assert "nothing to measure with: make the suites (" in done.stderr
    assert done.stderr.endswith(f", then --suites FOLDER), and cyclictest needs {THE_RIGHT}\n")


def test_nothing_is_proven_where_no_run_counts(quick, tmp_path):
    """No rate stands there without a run."""
    program = tmp_path / "made/lib/cyclic_timer_tests/cyclic_timer_tests"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\nexit 1\n")
    program.chmod(0o755)
    (tmp_path / "made/build.json").write_text("{}")
    status, printed, _ = quick("--deadline", "1ms", "--suites", "made", "--suite", "cyclic_timer_tests", "--for", "1s")
    assert status == 3
    assert "Nothing was measured that counts." in printed and "At most 1" not in printed
    assert "not analysed: 001-cyclic_timer_tests" in printed
