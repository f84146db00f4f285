"""Campaign files and the plans that follow from them."""

from pathlib import Path

import pytest

from rtfiles.errors import UsageError
from rtrun.campaign import read_campaign
from rtrun.cli import main

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"


def write(folder, text):
    path = folder / "campaign.yml"
    path.write_text("schema: 1\nname: test\n" + text)
    return path


def test_lists_are_multiplied_in_the_order_listed(tmp_path):
    path = write(
        tmp_path,
        """
common: {repetitions: 10, payload_bytes: 3}
runs:
  - {suite: oneshot_timer_tests, timeout_us: [1000, 10000], policy: [RR, 0]}
  - {suite: communication_tests, subscribers: [1, 5], frequency_hz: 100}
""",
    )
    _, runs = read_campaign(path)
    assert [run.name for run in runs] == [
        "001-oneshot_timer_tests_l10_tm1000-tnRTRR",
        "002-oneshot_timer_tests_l10_tm1000",
        "003-oneshot_timer_tests_l10_tm10000-tnRTRR",
        "004-oneshot_timer_tests_l10_tm10000",
        "005-ct_gnuplot_l10_fq100_pl3-1sub",
        "006-ct_gnuplot_l10_fq100_pl3-5sub",
    ]
    assert runs[0].parameters["policy"] == "RR" and runs[1].parameters["policy"] == "0"
    assert runs[4].parameters["start_delay_s"] == 1, "a publisher waits for its subscribers, as the launch files do"
    assert runs[0].expected_s == pytest.approx(10 * 1e-3)
    assert runs[5].expected_s == pytest.approx(10 / 100 + 1)


def test_a_run_wins_over_common(tmp_path):
    _, runs = read_campaign(
        write(tmp_path, "common: {policy: RR}\nruns: [{suite: cyclic_timer_tests, policy: FIFO}]\n")
    )
    assert [run.parameters["policy"] for run in runs] == ["FIFO"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("runs: [{suite: twoshot}]", "runs.0.suite: unknown suite 'twoshot', known: oneshot_timer_tests"),
        ("runs: [{}]", "runs.0.suite: unknown suite ''"),
        (
            "runs: [{suite: cyclic_timer_tests, polcy: RR}]",
            "runs.0: unknown key 'polcy', cyclic_timer_tests takes: suite, policy",
        ),
        ("runs: [{suite: cyclic_timer_tests, timeout_us: 5}]", "runs.0: unknown key 'timeout_us'"),
        ("runs: [{suite: cyclic_timer_tests, prefix: ../x}]", "runs.0: unknown key 'prefix'"),
        (
            "runs: [{suite: cyclic_timer_tests, policy: EDF}]",
            "runs.0.policy: policy takes one of 0, RR, FIFO, got 'EDF'",
        ),
        ("runs: [{suite: cyclic_timer_tests, repetitions: -1}]", "takes a whole number from 1 to 100000000, got -1"),
        ("runs: [{suite: cyclic_timer_tests, repetitions: [5, -1]}]", "runs.0.repetitions: .*got -1"),
        ("runs: [{suite: cyclic_timer_tests, repetitions: 1.5}]", "got 1.5"),
        ("runs: [{suite: cyclic_timer_tests, repetitions: true}]", "got True"),
        ("runs: [{suite: cyclic_timer_tests, repetitions: []}]", "runs.0.repetitions: the list is empty"),
        ("runs: [{suite: cyclic_timer_tests, priority: 98}]", "priority takes a whole number from 1 to 97, got 98"),
        (
            "runs: [{suite: communication_tests, subscribers: 0}]",
            "subscribers takes a whole number from 1 to 64, got 0",
        ),
        ("runs: []", "runs: List should have at least 1 item"),
        ("runs: 5", "runs: Input should be a valid list, got 5"),
        ("common: {speed: 5}\nruns: [{suite: cyclic_timer_tests}]", "common: unknown key 'speed', allowed: policy"),
        ("rums: 5", "unknown key 'rums', allowed: schema, name, common, runs"),
        ("runs: [{suite: cyclic_timer_tests, policy: RR, policy: RR}]", r"campaign.yml:3: key 'policy' is given twice"),
        ("runs: [", "campaign.yml:"),
    ],
)
def test_bad_campaigns_are_usage_errors_that_name_file_and_key(tmp_path, text, message):
    path = write(tmp_path, text + "\n")
    with pytest.raises(UsageError, match=message) as caught:
        read_campaign(path)
    assert str(path) in str(caught.value)


def test_every_mistake_is_told_at_once(tmp_path):
    path = write(tmp_path, "runs: [{suite: cyclic_timer_tests, policy: EDF, repetitions: 0}, {suite: none}]\n")
    with pytest.raises(UsageError) as caught:
        read_campaign(path)
    assert len(str(caught.value).splitlines()) == 3


def test_a_name_that_leaves_the_results_folder_is_refused(tmp_path):
    path = tmp_path / "campaign.yml"
    path.write_text("schema: 1\nname: ../../etc\nruns: [{suite: cyclic_timer_tests}]\n")
    with pytest.raises(UsageError, match="name: "):
        read_campaign(path)


@pytest.mark.parametrize("path", sorted(CAMPAIGNS.glob("*.yml")), ids=lambda path: path.stem)
def test_shipped_campaigns_plan(path, capsys):
    assert main(["plan", str(path)]) == 0
    assert "runs, " in capsys.readouterr().out.splitlines()[-1]


def test_exit_status_of_a_bad_campaign(tmp_path, capsys):
    assert main(["plan", str(tmp_path / "none.yml")]) == 2
    assert capsys.readouterr().err == f"rtrun: {tmp_path}/none.yml: No such file or directory\n"
