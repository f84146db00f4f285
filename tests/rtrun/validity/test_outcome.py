"""What became of a run, from the files that were downloaded."""

import json

import pytest
from written import write_cyclic

from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.program import Exit, Program
from rtrun.results.record import RunStatus
from rtrun.validity.outcome import judge

PROGRAM = Program(name="cyclic_timer_tests", argv=("cyclic_timer_tests",), deadline_s=30)


@pytest.fixture
def judged(tmp_path):
    path = write_cyclic(tmp_path)
    entry = {"suite": "cyclic_timer_tests", "policy": "RR", "frequency_hz": 7000, "repetitions": 3}
    (run,) = plan(Campaign(schema=1, name="test", runs=[entry]), "test")

    def judged(status=0, expired=False, refused=None, ended_early=None):
        verdict = judge(
            tmp_path,
            run,
            [PROGRAM],
            [Exit(status=status, expired=expired)],
            [path.stem],
            refused=refused or {},
            background=[],
            ended_early=ended_early or {},
        )
        return verdict.status, verdict.reason

    judged.path = path
    return judged


def test_a_good_run(judged):
    assert judged() == (RunStatus.OK, None)


def test_a_program_that_ended_badly(judged, tmp_path):
    assert judged(status=None, expired=True) == (
        RunStatus.FAILED,
        "cyclic_timer_tests did not end within 30 s and was ended",
    )
    assert judged(status=None) == (RunStatus.FAILED, "cyclic_timer_tests was killed from outside")
    (tmp_path / "cyclic_timer_tests.stderr").write_text("ERROR: no rights\n\n")
    assert judged(status=1) == (
        RunStatus.FAILED,
        "cyclic_timer_tests ended with exit status 1: ERROR: no rights",
    )


def test_a_file_that_was_not_taken(judged):
    name = judged.path.with_suffix(".npy").name
    assert judged(refused={name: "it is too large"}) == (RunStatus.FAILED, "it is too large")
    assert judged(refused={"other.npy": "it is too large"})[0] is RunStatus.OK


@pytest.mark.parametrize("ending", [".json", ".npy"])
def test_an_output_that_is_missing(judged, ending):
    path = judged.path.with_suffix(ending)
    path.unlink()
    assert judged() == (RunStatus.FAILED, f"{path.name} is missing though its program ended with exit status 0")


def test_a_background_program_that_ended_early(judged, tmp_path):
    assert judged(ended_early={"stress": ""}) == (
        RunStatus.INVALID,
        "condition idle: stress ended in the middle of the run, killed from outside",
    )
    (tmp_path / "stress.stderr").write_text("no memory\n")
    assert judged(ended_early={"stress": "3"})[1].endswith("with exit status 3: no memory")
    first = judged(ended_early={"stress": "", "hold-governor": "1"})[1]
    assert first.startswith("condition idle: stress ended"), "the first that ended"
    assert judged(status=1, ended_early={"stress": ""})[0] is RunStatus.FAILED, "the first thing that went wrong"


@pytest.mark.parametrize(
    ("change", "status", "reason"),
    [
        ({"complete": False, "incomplete_reason": "stopped"}, RunStatus.INCOMPLETE, "stopped"),
        (
            {"requested": {"policy": "RR", "repetitions": 3, "frequency_hz": 7001}},
            RunStatus.INVALID,
            "frequency_hz 7001",
        ),
        ({"schema": 2}, RunStatus.FAILED, "schema"),
    ],
)
def test_an_output_that_says_otherwise(judged, change, status, reason):
    judged.path.write_text(json.dumps(json.loads(judged.path.read_text()) | change))
    assert judged()[0] is status
    assert reason in judged()[1]
