"""Campaign files and the plans that follow from them."""

import json
import re
from pathlib import Path

import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.plan import suites
from rtrun.plan.campaign import read_campaign

CAMPAIGNS = Path(__file__).parents[3] / "campaigns"


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
    assert runs[0].least_s == pytest.approx(10 * 1e-3)
    assert runs[0].expected_s == pytest.approx(10 * 1.2e-3), "each shot has a latency, and is armed again"
    assert runs[5].expected_s == pytest.approx(10 / 100 + 1)


def test_a_run_without_timeout_still_takes_time(tmp_path):
    _, runs = read_campaign(
        write(tmp_path, "runs: [{suite: oneshot_timer_tests, timeout_us: 0, repetitions: 1000000}]\n")
    )
    assert runs[0].least_s == 0
    assert runs[0].expected_s == pytest.approx(200)
    _, runs = read_campaign(
        write(tmp_path, "runs: [{suite: cyclic_timer_tests, frequency_hz: 100000, repetitions: 1000000}]\n")
    )
    assert runs[0].least_s == pytest.approx(10)
    assert runs[0].expected_s == pytest.approx(200), "no board measures so fast"


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
            "runs.0: unknown key 'polcy', did you mean 'policy'\\? cyclic_timer_tests takes: suite, policy",
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
        (
            "runs: [{suite: communication_tests, depth: 10}]",
            "runs.0.depth: is for middleware rcl, rclcpp, and this run's is roscpp",
        ),
        ("runs: []", "runs: takes 1 or more entries"),
        ("runs: 5", "runs: takes a list, got 5"),
        ("common: {speed: 5}\nruns: [{suite: cyclic_timer_tests}]", "common: unknown key 'speed', allowed: policy"),
        ("rums: 5", "unknown key 'rums', did you mean 'runs'\\? allowed: schema, name, order, seed, common, runs"),
        ("runs: [{suite: cyclic_timer_tests, policy: RR, policy: RR}]", r"campaign.yml:3: key 'policy' is given twice"),
        ("runs: [", "campaign.yml:"),
    ],
)
def test_bad_campaigns_are_usage_errors_that_name_file_and_key(tmp_path, text, message):
    path = write(tmp_path, text + "\n")
    with pytest.raises(UsageError, match=message) as caught:
        read_campaign(path)
    assert str(path) in str(caught.value)


def test_what_a_middleware_does_not_take_makes_no_run_of_its_own(tmp_path):
    run = "{suite: communication_tests, middleware: [roscpp, rcl], depth: [10, 1000], rmw: rmw_x_cpp}"
    _, runs = read_campaign(write(tmp_path, f"common: {{domain_id: 7}}\nruns: [{run}]\n"))
    assert [(run.middleware, run.parameters.get("depth")) for run in runs] == [
        ("roscpp", None),
        ("rcl", 10),
        ("rcl", 1000),
    ]
    assert not {"depth", "reliability", "rmw", "domain_id"} & runs[0].parameters.keys()
    assert dict(suites.environment(runs[0].parameters)) == {}
    assert dict(suites.environment(runs[1].parameters)) == {"RMW_IMPLEMENTATION": "rmw_x_cpp", "ROS_DOMAIN_ID": "7"}
    publishers = [suites.argv(run.suite, "communication_tests_publisher", run.parameters) for run in runs]
    assert publishers == [
        ["communication_tests_publisher", "-d", "1", *options] for options in ((), ("--depth", "10"), ())
    ]


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


def test_plan_alone_lists_the_shipped_campaigns_and_what_each_is_for(capsys):
    assert main(["plan"]) == 0
    printed = capsys.readouterr().out
    listed = re.findall(r"^(\S+)  +(.+)$", printed.partition("\nnext: ")[0], re.M)
    assert [name for name, _ in listed] == sorted(path.stem for path in CAMPAIGNS.glob("*.yml"))
    assert max(map(len, printed.splitlines())) <= 100
    assert main(["plan", "--json"]) == 0
    campaigns = json.loads(capsys.readouterr().out)["campaigns"]
    for (name, first), campaign in zip(listed, campaigns, strict=True):
        assert campaign["campaign"] == name and campaign["purpose"].startswith(first) and "#" not in campaign["purpose"]
        assert campaign["purpose"].split()[-1] in (CAMPAIGNS / f"{name}.yml").read_text().partition("schema:")[0]
    for words in (["-k", "cyclic"], ["-k", ""], ["--assume-rate", "0.1"]):
        assert main(["plan", *words]) == 2
        assert "of which campaign?" in capsys.readouterr().err


def test_exit_status_of_a_bad_campaign(tmp_path, capsys):
    assert main(["plan", str(tmp_path / "none.yml")]) == 2
    assert capsys.readouterr().err == f"rtrun: {tmp_path}/none.yml: No such file or directory\n"


def test_conditions_settings_and_repeats_multiply_and_name_the_runs(tmp_path):
    path = write(
        tmp_path,
        """
common: {repetitions: 1000, condition: [idle, nodes], nodes_hz: [10, 100], repeats: 2}
runs: [{suite: cyclic_timer_tests, governor: performance}]
""",
    )
    _, runs = read_campaign(path)
    base = "cyclic_timer_tests_l1000_fq1000"
    assert [run.name for run in runs] == [
        f"001-{base}-governorperformance",
        f"002-{base}-governorperformance-r2",
        f"003-{base}-nodes-nodes_hz10-governorperformance",
        f"004-{base}-nodes-nodes_hz10-governorperformance-r2",
        f"005-{base}-nodes-governorperformance",
        f"006-{base}-nodes-governorperformance-r2",
    ], "idle takes no nodes_hz: it is planned once, not once for each of them"
    assert [run.repeat for run in runs] == [1, 2] * 3
    assert runs[2].settings["nodes_hz"] == 10 and runs[0].settings.keys() == {"governor", "irq_cpu", "sampler"}


def test_single_combinations_are_left_out_and_put_in(tmp_path):
    path = write(
        tmp_path,
        """
common: {repetitions: 1000}
runs: [{suite: oneshot_timer_tests, policy: [RR, FIFO], condition: [idle, cpu80]}]
exclude: [{policy: RR, condition: cpu80}, {policy: FIFO, condition: [idle]}]
include: [{suite: cyclictest, policy: RR, condition: cpu80}]
""",
    )
    _, runs = read_campaign(path)
    assert [(run.suite, run.parameters["policy"], run.condition) for run in runs] == [
        ("oneshot_timer_tests", "RR", "idle"),
        ("oneshot_timer_tests", "FIFO", "cpu80"),
        ("cyclictest", "RR", "cpu80"),
    ]


def test_an_interleaved_order_is_drawn_in_blocks_and_the_same_for_the_same_seed(tmp_path):
    text = "order: interleaved\nseed: {}\nruns: [{{suite: cyclic_timer_tests, frequency_hz: {}, repeats: 4}}]\n"
    frequencies = list(range(100, 110))

    def names(seed):
        _, runs = read_campaign(write(tmp_path, text.format(seed, frequencies)))
        assert [run.repeat for run in runs] == [1] * 10 + [2] * 10 + [3] * 10 + [4] * 10, (
            "a block has each combination once"
        )
        assert {run.seed for run in runs} == {seed}
        return [run.name for run in runs]

    assert names(1) == names(1) != names(2)
    assert sorted(names(1)) == sorted(names(2)), "a run keeps its name, wherever it stands"
    blocks = [[name.split("-")[1] for name in names(1)[start : start + 10]] for start in (0, 10, 20, 30)]
    assert blocks[1] == blocks[0][::-1] and blocks[3] == blocks[2][::-1], "all begin at the same time on average"
    assert blocks[0] != blocks[2] != blocks[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("condition: busy", "runs.0.condition: unknown condition 'busy', known: idle, cpu80"),
        ("governor: ../x", r"runs.0.governor: governor takes a text like \[a-z\]\+, got '../x'"),
        ("load_cpu: all", "load_cpu: load_cpu takes a text like"),
        ("nodes: 17", "nodes takes a whole number from 1 to 16, got 17"),
        ("repeats: [1, 2]", "runs.0.repeats: one whole number, not a list"),
        ("repeats: 0", "repeats takes a whole number from 1 to 10000, got 0"),
        ("cpu: '0,1,'", "runs.0.cpu: cpu takes a text like"),
        ("cpu: 0-999999999", "runs.0.cpu: cpu takes a text like"),
        ("cpu: 0-9999", "runs.0.cpu: cpu takes a list of CPUs like 0-1,4, got '0-9999': .* from 0 to 8191"),
        ("cpu: 3-1", "runs.0.cpu: cpu takes a list of CPUs like 0-1,4, got '3-1'"),
        ("load_cpu: 3-1", "runs.0.load_cpu: load_cpu takes a list of CPUs"),
        ("irq_cpu: 0-9999", "runs.0.irq_cpu: irq_cpu takes a list of CPUs"),
    ],
)
def test_bad_conditions(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read_campaign(write(tmp_path, f"runs: [{{suite: cyclic_timer_tests, {text}}}]\n"))


def test_idle_states_are_shut_in_one_way(tmp_path):
    asked = "runs: [{suite: cyclictest, deepest_idle_state: [-1, 1]%s}]\n"
    with pytest.raises(UsageError, match=r"-1 would change nothing .* 0 keeps .*: give cpu_dma_latency_us: null"):
        read_campaign(write(tmp_path, asked % ""))
    _, runs = read_campaign(write(tmp_path, asked % ", cpu_dma_latency_us: null"))
    assert [run.parameters["deepest_idle_state"] for run in runs] == [-1, 1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("order: interleaved", "seed: give one"),
        ("seed: 3", "seed: give one"),
        ("exclude: [{policy: RR}]", "exclude.0: no run has all of"),
        ("exclude: [{}]", "exclude.0: no run has all of"),
        ("exclude: [{suite: cyclic_timer_tests}]", "exclude: leaves no run"),
    ],
)
def test_bad_orders_and_exclusions(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read_campaign(write(tmp_path, f"{text}\nruns: [{{suite: cyclic_timer_tests}}]\n"))


def test_a_campaign_of_more_runs_than_anybody_measures(tmp_path):
    """80 million runs in 300 bytes: refused before any of them is made."""
    lists = "".join(f"{key}: {list(range(1, 21))}, " for key in ("timeout_us", "priority", "repetitions"))
    path = write(tmp_path, f"runs: [{{suite: oneshot_timer_tests, {lists} repeats: 10000}}]\n")
    with pytest.raises(UsageError, match=r"runs.0: makes 80000000 runs, at most 100000 are allowed"):
        read_campaign(path)
    many = "{suite: cyclic_timer_tests, repeats: 10000}"
    with pytest.raises(UsageError, match=r"campaign.yml: makes 110000 runs, at most 100000 are allowed"):
        read_campaign(write(tmp_path, f"runs: [{', '.join([many] * 400)}]\n"))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("suite: cyclic_timer_tests, repetitions: 999, condition: cpu80", "condition cpu80"),
        ("suite: cyclic_timer_tests, repetitions: 999, governor: performance", "governor performance"),
        ("suite: cyclictest, repetitions: 999, policy: RR", "policy RR"),
        ("suite: cyclictest, repetitions: 999, cpu: 1", "cpu 1"),
    ],
)
def test_a_run_that_is_never_observed_long_enough_to_be_valid_is_not_planned(tmp_path, text, what):
    with pytest.raises(UsageError, match=rf"measures 0.999 s, but {what} must be observed.* measure 1 s at least"):
        read_campaign(write(tmp_path, f"runs: [{{{text}}}]\n"))
    long_enough = text.replace("999", "1000")
    read_campaign(write(tmp_path, f"runs: [{{{long_enough}}}]\n"))
    with pytest.raises(UsageError, match=rf"{what} must be observed: sampler none is for runs without it"):
        read_campaign(write(tmp_path, f"runs: [{{{long_enough}, sampler: none}}]\n"))


def test_the_plan_says_what_is_waited_for(tmp_path, capsys):
    path = write(tmp_path, "runs: [{suite: cyclic_timer_tests, condition: [idle, cpu80], repeats: 2}]\n")
    assert main(["plan", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("  1.0 s") and lines[2].endswith("  1.0 s + 1 s for the load to settle")
    assert lines[-1] == (
        "4 runs, 11 s: 4 s of measuring, 2 s for loads to settle, "
        "about 5 s for set-up and for programs to start and end"
    )


def test_the_published_table_is_in_the_shipped_campaign():
    _, runs = read_campaign(CAMPAIGNS / "thesis-2014.yml")
    oneshot = [
        (run.kernel, run.condition, run.parameters["timeout_us"], run.parameters["policy"])
        for run in runs
        if run.suite == "oneshot_timer_tests"
    ]
    assert len(oneshot) == 24 and set(oneshot) == {
        (kernel, condition, timeout_us, policy)
        for kernel in ("standard", "rt")
        for condition in ("idle", "cpu80")
        for timeout_us in (1000, 10000)
        for policy in ("0", "RR", "FIFO")
    }
    assert {run.parameters["repetitions"] for run in runs if run.suite != "cyclictest"} == {2_000_000, 4_000_000}
    for kernel in ("standard", "rt"):
        cyclictest = [run for run in runs if run.suite == "cyclictest" and run.kernel == kernel]
        assert sum(int(run.parameters["repetitions"]) for run in cyclictest) == 40_000_000


def test_71_runs_of_184_million_messages_are_planned(tmp_path, capsys):
    path = write(
        tmp_path,
        """
runs:
  - {suite: communication_tests, frequency_hz: [100, 1000], policy: RR, repetitions: 2000000, repeats: 25}
  - {suite: communication_tests, frequency_hz: 100, policy: FIFO, repetitions: 4000000, repeats: 21}
""",
    )
    assert main(["plan", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 72 and lines[-1].startswith("71 runs, ")
    _, runs = read_campaign(path)
    assert sum(int(run.parameters["repetitions"]) for run in runs) == 184_000_000
