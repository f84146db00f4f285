"""Campaigns whose runs observe programs that are no suite's."""

import json

import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.plan.campaign import read_campaign
from rtrun.plan.observation import ObservedSystem
from rtrun.plan.run import digest_of

SUBJECT = "subject: attached\n"
RUNS = "runs: [{condition: [idle, cpu80], repeats: 2}]\n"
UNTIL = "order: interleaved\nseed: 1\nuntil: {probability: 0.01, at_most: 1h}\n"


def write(folder, text):
    path = folder / "campaign.yml"
    path.write_text("schema: 1\nname: test\n" + text)
    return path


def test_each_run_observes_the_same_under_its_condition(tmp_path):
    system = "subject: {start: ros2 launch a b.py, ready: topic /x}\nfor: 90s\n"
    streams = "deadlines: [/x=5ms, 'timer:/n=1ms']\npaths: ['/a,/x']\n"
    _, runs = read_campaign(write(tmp_path, system + streams + RUNS))
    assert [run.name for run in runs] == [
        "001-observation",
        "002-observation-r2",
        "003-observation-cpu80",
        "004-observation-cpu80-r2",
    ]
    assert {run.expected_s for run in runs} == {90.0} and runs[2].settle_s > 0
    (plan,) = {json.dumps(run.subject.followed) for run in runs}
    assert plan == '[["/a", "/x"]]'
    assert runs[0].subject.system == ObservedSystem(start="ros2 launch a b.py", ready_topic="/x")
    assert [deadline.text for deadline in runs[0].subject.deadlines] == ["messages:/x=5000000ns", "timer:/n=1000000ns"]


def test_what_is_observed_tells_one_campaign_from_another(tmp_path):
    texts = [SUBJECT, SUBJECT + "for: 2min\n", SUBJECT + "deadlines: [/x=5ms]\n", SUBJECT + "deadlines: [/x=6ms]\n"]
    texts += ["subject: {start: a}\n", "subject: {start: b}\n"]
    digests = [digest_of(read_campaign(write(tmp_path, text + RUNS))[1]) for text in texts]
    assert len(set(digests)) == len(texts)
    assert digest_of(read_campaign(write(tmp_path, SUBJECT + "for: 1min\n" + RUNS))[1]) == digests[0]


def test_a_traced_run_has_a_twin_and_no_warm_up(tmp_path):
    _, runs = read_campaign(write(tmp_path, SUBJECT + "runs: [{trace: {above: p99.9}}]\n"))
    assert [(run.trace, dict(run.parameters)) for run in runs] == [("off", {}), ("p99.9", {})]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("subject: atached\n" + RUNS, "subject: 'atached': takes attached, .*did you mean 'attached'"),
        ("subject: {start: x, redy: topic /a}\n" + RUNS, "subject: unknown key 'redy', did you mean 'ready'"),
        ("subject: {ready: topic /a}\n" + RUNS, "subject: start: takes the command"),
        ("subject: {start: x, ready: /a}\n" + RUNS, "subject: ready: takes topic NAME, as topic /cmd_vel, got '/a'"),
        (
            "subject: {start: x, ready: topic a}\n" + RUNS,
            "subject: 'a': the full name of a topic or a service begins with /",
        ),
        (SUBJECT + "deadline: [/a=1ms]\n" + RUNS, "unknown key 'deadline', did you mean 'deadlines'"),
        (SUBJECT + "deadlines: [/x=5ms, /x=9ms]\n" + RUNS, "deadlines.1: messages:/x=9000000ns: it has another"),
        (SUBJECT + "deadlines: ['timr:/a=1ms']\n" + RUNS, "4: deadlines.0: 'timr:/a=1ms': takes TOPIC=TIME"),
        (SUBJECT + "runs: [{conditon: idle}]\n", "runs.0: unknown key 'conditon', did you mean 'condition'"),
        (SUBJECT + "runs: [{suite: cyclic_timer_tests}]\n", "with subject nothing but that is measured"),
        ("for: 1s\nruns: [{suite: cyclic_timer_tests}]\n", "for: is for campaigns with subject"),
        ("runs: [{suite: observation}]\n", "unknown suite 'observation', known: oneshot"),
        (SUBJECT + UNTIL + RUNS, "until: give deadlines"),
        (SUBJECT + "deadlines: [/x=5ms]\n" + UNTIL.replace("{", "{of: jitter, ") + RUNS, "until.of: leave it out"),
        (UNTIL + "runs: [{suite: cyclic_timer_tests}]\n", "until.deadline: is missing"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path, text, match):
    with pytest.raises(UsageError, match=match):
        read_campaign(write(tmp_path, text))


def test_how_long_a_goal_takes_is_not_foreseen(tmp_path, capsys):
    runs = "runs: [{condition: idle}]\n"
    path = str(write(tmp_path, SUBJECT + "deadlines: [/x=5ms]\n" + UNTIL + runs))
    assert main(["plan", path]) == 0
    assert "for each of messages:/x=5000000ns" in capsys.readouterr().out
    assert main(["plan", path, "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert planned["goal"]["forecasts"] == [] and planned["runs"][0]["observation"]["for_s"] == 60.0
    assert main(["plan", path, "--assume-rate", "0.1"]) == 2, capsys.readouterr()
