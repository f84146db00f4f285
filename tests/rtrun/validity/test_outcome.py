"""What became of a run, from the files that were downloaded."""

import json

import pytest
from written import write_cyclic

from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.program import Exit, Program
from rtrun.plan.suites import program_json_names
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


HEAD = ("schema", "version", "complete", "incomplete_reason", "in_effect", "host", "kernel", "start_time", "end_time")


def write_sender(folder, run, *, sent, rate):
    """The json of a publisher that has sent so many messages."""
    head = json.loads(write_cyclic(folder).read_text())
    sender = {key: head[key] for key in HEAD} | {"suite": run.suite, "program": "communication_tests_publisher"}
    sender |= {"requested": {}, "counts": {"asked": sent, "sent": sent}, "rate": rate}
    (name,) = program_json_names(run.suite, run.parameters).values()
    (folder / name).write_text(json.dumps(sender))


@pytest.mark.parametrize(
    ("achieved_hz", "sent", "is_timed", "reason"),
    [
        (
            6981.0,
            1000,
            True,
            "asked for 200000 Hz, achieved 6981 Hz, 7 overruns, 9 skipped periods: off by 96.5 %, 1 % at",
        ),
        (198_100.0, 1000, True, None),
        (197_900.0, 1000, True, "off by 1.05 %"),
        (203_000.0, 1000, True, "off by 1.5 %"),
        (197_000.0, 50, True, None),  # one period and no more
        (None, 1, True, None),
        (6981.0, 1000, False, None),
    ],
)
def test_a_publisher_that_misses_its_rate(tmp_path, achieved_hz, sent, is_timed, reason):
    entry = {"suite": "communication_tests", "frequency_hz": 200_000, "repetitions": sent}
    (run,) = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    rate = {"asked_hz": 200_000, "achieved_hz": achieved_hz, "overruns": 7, "skipped": 9}
    write_sender(tmp_path, run, sent=sent, rate=rate)
    programs = [
        Program(name=f"communication_tests_{name}", argv=(), deadline_s=30) for name in ("subscriber", "publisher")
    ]
    ended = [Exit(status=0, expired=False)] * 2
    verdict = judge(tmp_path, run, programs, ended, [], refused={}, background=[], ended_early={}, is_timed=is_timed)
    assert (verdict.status is RunStatus.OK) == (reason is None)
    assert reason is None or reason in verdict.reason
    assert verdict.heads["communication_tests_publisher"].rate.skipped == 9


def test_a_publisher_through_another_middleware_than_asked_for(tmp_path):
    entry = {"suite": "communication_tests", "middleware": "tcp", "repetitions": 10}
    (run,) = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    write_sender(tmp_path, run, sent=10, rate={"asked_hz": 1000, "achieved_hz": 1e3, "overruns": 0, "skipped": 0})
    program = Program(name="communication_tests_publisher", argv=(), deadline_s=30)
    ended = [Exit(status=0, expired=False)]
    verdict = judge(tmp_path, run, [program], ended, [], refused={}, background=[], ended_early={})
    assert verdict.status is RunStatus.INVALID
    assert verdict.reason == f"{program.name}: asked for the middleware tcp, it measured through roscpp"


def test_idle_cpus_that_slept_deeper_than_asked(tmp_path):
    path = write_cyclic(tmp_path)
    record = json.loads(path.read_text())
    record["requested"]["cpu_dma_latency_us"] = 0
    entry = {"suite": "cyclic_timer_tests", "policy": "RR", "frequency_hz": 7000, "repetitions": 3}
    (run,) = plan(Campaign(schema=1, name="test", runs=[entry | {"cpu_dma_latency_us": 0}]), "test")
    for held, reason in ((0, None), (70, f"{path.stem}: asked for cpu_dma_latency_us 0, in effect was 70")):
        record["in_effect"]["cpu_dma_latency_us"] = held
        path.write_text(json.dumps(record))
        ended = [Exit(status=0, expired=False)]
        outcome = judge(tmp_path, run, [PROGRAM], ended, [path.stem], refused={}, background=[], ended_early={})
        assert outcome.reason == reason
