"""`rtrun quick` on this machine: without any file, from what it finds to a first answer, and files to go on from."""

import re
import shutil

import pytest

from rtrun.cli import main
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
    """The suites whose programs a busy machine kept from their rate: these runs do not count, and it is said why.

    No run may lack anything else.
    """
    records = [read_record(path.parent) for path in results.glob("*/run.json")]
    bad = [record for record in records if record.status is not RunStatus.OK]
    assert all(re.search(r"asked for \d+ Hz, achieved", record.reason or "") for record in bad), bad
    return {record.suite for record in bad}


def test_a_first_answer_needs_no_file_and_leaves_those_to_go_on_from(quick, suites, tmp_path):
    status, printed, _ = quick("--deadline", "60s", "--for", "6s", "--suites", suites)
    late = kept_from_its_rate(tmp_path / "results" / "quick")
    assert status == (3 if late else 0), printed
    (heading,) = [line for line in printed.splitlines() if line.startswith("What this proves of P(value > 60 s)")]
    rows = [re.split(r" {2,}", line.strip()) for line in printed.split(heading)[1].splitlines()[3:]]
    measured = {row[0].split(" ")[0]: row for row in rows if len(row) == 5}
    wanted = {"cyclic_timer", "oneshot_timer", "communication"}
    assert measured.keys() >= wanted - {name.removesuffix("_tests") for name in late}
    assert all(re.search(rf"^not analysed: .*{name}", printed, re.M) for name in wanted - measured.keys()), printed
    assert ("cyclictest" in measured) == (shutil.which("cyclictest") is not None)
    # Beside other tests a row may not stay the same: then no P is claimed, and it is said why.
    assert all(f"{row[0]}: no P: " in printed if row[3] == "-" else 0 < float(row[3]) < 1 for row in measured.values())
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
    assert status == (3 if kept_from_its_rate(tmp_path / "results" / "quick-2") else 0), printed
    assert "report results/quick-2 --deadline 1ms\n" in printed
    assert "--target boards/here.yml --fresh" in printed
    assert not (tmp_path / "results" / "quick-2" / "target.yml").exists()
    runs = {path.parent.name.partition("_l")[0] for path in tmp_path.glob("results/quick-2/*/run.json")}
    assert runs <= {f"{number:03}-oneshot_timer_tests" for number in (1, 2)} and runs


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--suite", "cyclic"], "--suite cyclic: not there through roscpp, found: "),
        (["--suite", "oneshot_timer_tests", "--middleware", "rcl"], "not there through rcl, found: "),
        (["--target", "none.yml"], "none.yml: "),
        (["--target", "a.yml", "--suites", "there"], "--suites: a target file names them itself"),
        (["--target", "root@"], "--target root@: takes USER@HOST, or a target file"),
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
