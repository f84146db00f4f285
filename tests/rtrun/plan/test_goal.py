"""What a campaign states as its goal, and the variants that it measures side by side."""

import json
from dataclasses import replace

import pytest

from rtfiles.errors import UsageError
from rtrun.analysis.chance.further import plan_measurements
from rtrun.cli import main
from rtrun.plan.campaign import read_campaign
from rtrun.plan.quantities import read_time_ns
from rtrun.plan.question import Tolerance
from rtrun.plan.run import SET_UP_S, digest_of
from rtrun.results.goal_file import read_goal, write_goal

INTERLEAVED = "order: interleaved\nseed: 7\n"
UNTIL = "until: {deadline: 400us, probability: 1e-6, confidence: 0.95, at_most: 8h, boots: 8}\n"
SINGLY = UNTIL.replace("boots: 8", "boots: 8, bursts: 1")
RUNS = "runs: [{suite: cyclic_timer_tests, policy: [RR, FIFO]}]\n"


def write(folder, text):
    path = folder / "campaign.yml"
    path.write_text("schema: 1\nname: test\n" + text)
    return path


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("400us", 400_000),
        ("1.5ms", 1_500_000),
        ("8h", 28_800_000_000_000),
        ("90 min", 5_400_000_000_000),
        ("1ns", 1),
        ("7d", 604_800 * 10**9),
        ("2w", 1_209_600 * 10**9),
    ],
)
def test_a_time_has_a_unit(text, time_ns):
    assert read_time_ns(text) == time_ns


@pytest.mark.parametrize("text", ["400", "0us", "-1ms", "1e3us", "400 u", "", 400, None, "9999999h", "٤us", "0.1ns"])
def test_what_is_no_time(text):
    with pytest.raises(ValueError, match="no time above 0 with its unit"):
        read_time_ns(text)


def test_the_goal_of_a_campaign(tmp_path):
    campaign, runs = read_campaign(write(tmp_path, INTERLEAVED + UNTIL + RUNS))
    goal = campaign.until
    assert (goal.deadline_ns, goal.probability, goal.confidence) == (400_000, 1e-6, 0.95)
    assert (goal.at_most_ns, goal.boots) == (28_800_000_000_000, 8)
    assert [run.repeat for run in runs] == [1, 1]


def test_a_goal_names_what_it_is_of_and_what_it_tolerates(tmp_path):
    more = UNTIL.replace("boots: 8", "of: jitter, tolerate: 3 of 100")
    goal = read_campaign(write(tmp_path, INTERLEAVED + more + RUNS))[0].until
    assert goal.question.miss == "more than 3 of 100 with jitter > 400 us"
    write_goal(tmp_path, goal)
    assert read_goal(tmp_path) == goal
    # A miss too many is in 97 windows.
    windows = replace(goal.question, bursts=1)
    single = plan_measurements(replace(windows, tolerance=Tolerance()))
    assert plan_measurements(windows)[1] == pytest.approx(97 * single[1], rel=1e-6)


ONESHOT = "runs: [{suite: oneshot_timer_tests}]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            INTERLEAVED + UNTIL.replace("boots: 8", "of: jitter") + ONESHOT,
            "until.of: oneshot_timer_tests measures latency, not jitter",
        ),
        (INTERLEAVED + UNTIL.replace("boots: 8", "of: drift") + RUNS, "until.of: "),
        (
            INTERLEAVED + UNTIL.replace("boots: 8", "tolerate: 3 of 3") + RUNS,
            "until.tolerate: '3 of 3' is neither a number of misses in a row, as '2 in a row', nor",
        ),
        (INTERLEAVED + UNTIL.replace("boots: 8", "tolerate: 1 of 1001") + RUNS, "of which there are at most 1000"),
        (UNTIL + RUNS, "until: give order: interleaved and a seed"),
        (INTERLEAVED + UNTIL + "runs: [{suite: cyclic_timer_tests, repeats: 2}]", "until: takes no repeats"),
        (INTERLEAVED + UNTIL + "runs: [{suite: hwlatdetect}]", "until: hwlatdetect measures no deadline"),
        (INTERLEAVED + UNTIL.replace("400us", "400") + RUNS, "until.deadline: '400' is no time above 0"),
        (INTERLEAVED + UNTIL.replace("1e-6", "2") + RUNS, "until.probability: '2' is no number between 0 and 1"),
        (
            INTERLEAVED + UNTIL.replace("8}", "{unlike: 5 percent}}") + RUNS,
            "until.boots: '5 percent' is no share",
        ),
        (
            INTERLEAVED + UNTIL.replace("8}", "{alike: 5%}}") + RUNS,
            "until.boots: neither a number of boots nor",
        ),
        (INTERLEAVED + UNTIL.replace("boots: 8", "bursts: 0") + RUNS, "until.bursts: "),
        (INTERLEAVED + UNTIL.replace("boots: 8", "boots: 0") + RUNS, "until.boots: "),
        (INTERLEAVED + "until: {deadline: 1ms, probability: 0.1}\n" + RUNS, "until.at_most: is missing"),
        (
            INTERLEAVED + UNTIL.replace("boots", "reboots") + RUNS,
            "until: unknown key 'reboots', did you mean 'boots'\\? allowed: deadline",
        ),
    ],
)
def test_bad_goals_are_usage_errors_that_name_the_key(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read_campaign(write(tmp_path, text))


VARIANTS = "variants: {old: {suites: ../old}, new: {suites: ../new, ros_setup: /opt/ros/x/setup.sh, priority: 90}}\n"


def test_every_run_is_planned_for_each_variant_in_one_order(tmp_path):
    campaign, runs = read_campaign(
        write(tmp_path, INTERLEAVED + VARIANTS + "runs: [{suite: cyclic_timer_tests, policy: RR, repeats: 5}]\n")
    )
    assert [run.repeat for run in runs] == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5], "each block has each variant once"
    assert all({a.variant, b.variant} == {"old", "new"} for a, b in zip(runs[::2], runs[1::2], strict=True))
    assert {run.variant: run.parameters["priority"] for run in runs} == {"old": 95, "new": 90}
    assert all(f"-{run.variant}" in run.name for run in runs)
    assert campaign.variants["new"]["suites"] == "../new"
    # With other programs it is another campaign: one that was begun does not go on with them.
    again = (
        INTERLEAVED
        + VARIANTS.replace("../new", "../newer")
        + "runs: [{suite: cyclic_timer_tests, policy: RR, repeats: 5}]\n"
    )
    assert digest_of(read_campaign(write(tmp_path, again))[1]) != digest_of(runs)


def test_a_variants_value_counts_for_the_runs_that_take_it(tmp_path):
    text = "variants: {a: {}, b: {timeout_us: 5000}}\nruns: [{suite: cyclic_timer_tests}, {suite: oneshot_timer_tests}]"
    _, runs = read_campaign(write(tmp_path, INTERLEAVED + text + "\n"))
    assert len(runs) == 4
    assert {run.parameters.get("timeout_us") for run in runs if run.variant == "b"} == {None, 5000}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (VARIANTS + RUNS, "variants: give order: interleaved and a seed"),
        (INTERLEAVED + "variants: {a: {}}\n" + RUNS, "variants: give at least two, or none"),
        (INTERLEAVED + "variants: {a: {}, b: {speed: 5}}\n" + RUNS, "variants.b: unknown key 'speed', allowed: suites"),
        (INTERLEAVED + "variants: {a: {}, b: {suites: 5}}\n" + RUNS, "variants.b.suites: takes a path, got 5"),
        (INTERLEAVED + "variants: {a: {}, b: {policy: [RR]}}\n" + RUNS, "variants.b.policy: one value, not a list"),
        (INTERLEAVED + "variants: {a: {}, b: {repeats: 2}}\n" + RUNS, "variants.b: unknown key 'repeats'"),
        (INTERLEAVED + "variants: {../a: {}, b: {}}\n" + RUNS, "variants"),
    ],
)
def test_bad_variants_are_usage_errors_that_name_the_key(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read_campaign(write(tmp_path, text))


def test_the_plan_says_how_long_it_takes(tmp_path, capsys):
    text = INTERLEAVED + SINGLY + "runs: [{suite: cyclic_timer_tests, repetitions: 250002, policy: [RR, FIFO]}]\n"
    path = write(tmp_path, text)
    assert main(["plan", str(path), "--assume-rate", "1e-7"]) == 0
    scope, best, assumed, *bursts, load, longer = capsys.readouterr().out.splitlines()[-7:]
    assert scope == (
        "on 8 boots: boots of another kind may be up to 37 % of all; a proof covers misses that come singly"
    )
    assert [line.split(":")[0] for line in bursts] == ["to cover bursts of 5 (bursts", "to cover bursts of 20 (bursts"]
    # Two of the 18 rounds of 250 s are a boot.
    assert load.startswith("a load that comes every 83 s or more often comes back five times within the runs of a boot")
    assert longer == "for a slower one make the runs longer (repetitions), every 600 s: 7.2 times"
    # 18 rounds of two runs with 0.6 s each to start and end, and 8 restarts of 60 s.
    times = "about 2 h 38 min, of which 2 h 30 min are measuring"
    assert best == f"without a miss: PROVEN after 18 rounds and 8 restarts, {times}"
    assert assumed.startswith(
        "if 1e-07 of all measurements miss it: PROVEN after 52 rounds and 25 restarts nine times "
    )
    assert main(["plan", str(path), "--assume-rate", "1e-6"]) == 0
    assert "no number of measurements is likely to decide it" in capsys.readouterr().out
    assert main(["plan", str(write(tmp_path, RUNS)), "--assume-rate", "1e-6"]) == 2
    assert "the campaign has no goal (until)" in capsys.readouterr().err


def test_the_plan_counts_on_a_stall_of_10_ms(tmp_path, capsys):
    runs = "runs: [{suite: cyclic_timer_tests, repetitions: 250002, frequency_hz: FREQUENCIES}]\n"
    goal = UNTIL.replace(", boots: 8", "")

    def planned(frequencies, until=goal):
        path = write(tmp_path, INTERLEAVED + until + runs.replace("FREQUENCIES", frequencies))
        assert main(["plan", str(path)]) == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if "load" not in line]
        scope, best, *prices = lines[[line.startswith("on 1 boot") for line in lines].index(True) :]
        return scope.split("; ")[1], best, [line.split(":")[0] for line in prices]

    def rounds(best):
        return int(best.split("PROVEN after ")[1].split()[0])

    scope, best, prices = planned("[1000]")
    assert scope == "a proof covers bursts of 10 ms (10 misses in a row, the default)"
    assert prices == [
        f"to cover {what}" for what in ("single misses (bursts", "bursts of 5 (bursts", "bursts of 20 (bursts")
    ]
    assert rounds(best) == -(-36_888_777 // 250_000)
    assert rounds(planned("[1000]", goal.replace("at_most", "bursts: 10, at_most"))[1]) == rounds(best)
    assert planned("[100]")[0] == "a proof covers bursts of 10 ms (a single miss, the default)"
    assert rounds(planned("[100]")[1]) == 15
    # Each group has to cover what a stall is at its own period.
    scope, both, _ = planned("[100, 1000]")
    assert scope == "a proof covers bursts of 10 ms (1 to 10 misses in a row, the default)" and rounds(both) == rounds(
        best
    )


def test_the_plan_for_programs(tmp_path, capsys):
    text = INTERLEAVED + SINGLY + "runs: [{suite: cyclic_timer_tests, repetitions: 250002, policy: [RR, FIFO]}]\n"
    path = write(tmp_path, text)
    assert main(["plan", str(path), "--json", "--assume-rate", "1e-6"]) == 0
    data = json.loads(capsys.readouterr().out)
    _, runs = read_campaign(path)
    assert [run["run"] for run in data["runs"]] == [run.name for run in runs]
    assert {run["parameters"]["policy"] for run in data["runs"]} == {"RR", "FIFO"}
    assert (data["schema"], data["campaign"], data["order"], data["seed"]) == (1, "test", "interleaved", 7)
    assert data["measuring_s"] == sum(run["expected_s"] for run in data["runs"]) == pytest.approx(500.004)
    assert data["total_s"] == data["measuring_s"] + data["settling_s"] + data["start_and_end_s"]
    assert data["total_s"] == pytest.approx(SET_UP_S + sum(run.total_s for run in runs))
    assert data["goal"]["deadline_ns"] == 400_000
    assert data["goal"]["slowest_load_s"] == pytest.approx(2 * 250.002 / 6)
    assert data["goal"]["forecasts"] == [
        {
            "assumed_rate": 0.0,
            "answer": "PROVEN",
            "outlook": {
                "rounds": 18,
                "boots": 9,
                "measuring_s": pytest.approx(9000.072),
                "total_s": pytest.approx(9503.172),
            },
        },
        {"assumed_rate": 1e-6, "answer": None, "outlook": None},
    ]
    assert main(["plan", str(write(tmp_path, RUNS.replace("policy", "condition: cpu80, policy"))), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["goal"] is None and data["seed"] is None
    assert data["settling_s"] == sum(run["settle_s"] for run in data["runs"]) > 0
