"""Each claim of the thesis, confirmed and refuted by campaigns made to do so."""

from dataclasses import replace

import numpy as np
import pytest
from report.campaigns import NOT_FIRED, cyclic_run, latencies, message_run, oneshot_run

from rtrun.analysis.comparison.differences import ComparisonAnswer
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS, Question
from rtrun.results.importers.adopt import adopt
from rtrun.targets.inspection.platform import Platform
from rtrun.thesis import general
from rtrun.thesis.examination import Finding, compared
from rtrun.thesis.examiners import EXAMINERS, examine_claims
from rtrun.thesis.reference import published

CONFIRMED, REFUTED, UNDECIDED = Finding.CONFIRMED, Finding.REFUTED, Finding.UNDECIDED
IDS = [claim["id"] for claim in published()["claims"]]


def examine(root, claim):
    return next(examined.result for examined in examine_claims(study(root, bounds=False)) if examined.id == claim)


def with_values(values, *changes):
    values = values.copy()
    for index, value in changes:
        values[index] = value
    return values


def test_every_claim_has_an_answer_and_none_without_runs(tmp_path):
    message_run(tmp_path, "a", [latencies(50, 1)])
    examined = examine_claims(study(tmp_path, THESIS))
    assert [claim.id for claim in examined] == IDS and len(IDS) == 19 and set(IDS) == set(EXAMINERS)
    for claim in examined:
        assert claim.result.runs or claim.result.finding == UNDECIDED


@pytest.mark.parametrize(("mean_us", "finding"), [(300.0, CONFIRMED), (90.0, REFUTED)])
def test_timeouts_below_a_millisecond(tmp_path, mean_us, finding):
    oneshot_run(tmp_path, "a", latencies(3000, 1, mean_us), timeout_us=800)
    oneshot_run(tmp_path, "b", latencies(3000, 2, 95.0))
    assert examine(tmp_path, "oneshot-sub-millisecond").finding == finding


def test_a_slow_timer_alone_does_not_show_that_a_millisecond_was_waited(tmp_path):
    oneshot_run(tmp_path, "a", latencies(3000, 1, 900.0), timeout_us=800)
    assert examine(tmp_path, "oneshot-sub-millisecond").finding == UNDECIDED
    oneshot_run(tmp_path, "b", latencies(3000, 2, 890.0))
    assert examine(tmp_path, "oneshot-sub-millisecond").finding == UNDECIDED


@pytest.mark.parametrize(
    ("rt", "other", "finding"), [(None, 5, CONFIRMED), (5, None, REFUTED), (None, None, UNDECIDED)]
)
def test_timers_that_never_fire(tmp_path, rt, other, finding):
    for name, policy, index in (("a", "RR", rt), ("b", "0", other)):
        values = latencies(4000, 1)
        oneshot_run(tmp_path, name, values if index is None else with_values(values, (index, NOT_FIRED)), policy=policy)
    assert examine(tmp_path, "oneshot-ignored-without-rt").finding == finding


@pytest.mark.parametrize(
    ("rt_ns", "other_ns", "finding"),
    [(8000, 3_000_000, CONFIRMED), (15_000, 3_000_000, REFUTED), (8000, 9000, UNDECIDED)],
)
def test_reported_latency(tmp_path, rt_ns, other_ns, finding):
    oneshot_run(tmp_path, "a", latencies(500, 1), policy="RR", off_ns=rt_ns)
    oneshot_run(tmp_path, "b", latencies(500, 2), policy="0", off_ns=other_ns)
    assert examine(tmp_path, "oneshot-reported-accurate").finding == finding


def test_nothing_measured_is_no_probability(tmp_path):
    oneshot_run(tmp_path, "a", latencies(500, 1), policy="RR")
    numbers = examine(tmp_path, "oneshot-ignored-without-rt").numbers
    assert numbers == "not fired: no run without priority, 0 of 500 with it"


def test_a_cyclic_log_that_tells_no_frequency_decides_nothing(tmp_path):
    log = tmp_path / "kept.log"
    cyclic_run(tmp_path / "source", "a", latencies(500, 1), logs=True, hz=1000)
    text = next((tmp_path / "source" / "a").glob("*.log")).read_text()
    log.write_text("".join(line for line in text.splitlines(keepends=True) if not line.startswith("set output")))
    result = examine(log, "cyclic-frequency-kept")
    assert (result.finding, result.numbers) == (UNDECIDED, "no cyclic run whose frequency is known in this campaign")


def test_400_us_rarely_exceeded(tmp_path):
    oneshot_run(tmp_path / "few", "a", latencies(5000, 1))
    assert examine(tmp_path / "few", "oneshot-400us-rare").finding == UNDECIDED
    oneshot_run(tmp_path / "late", "a", with_values(latencies(5000, 1), *((k, 500_000) for k in range(0, 5000, 500))))
    assert examine(tmp_path / "late", "oneshot-400us-rare").finding == REFUTED
    oneshot_run(tmp_path / "many", "a", latencies(4_000_000, 1))
    result = examine(tmp_path / "many", "oneshot-400us-rare")
    assert result.finding == CONFIRMED and "0 of 4000000" in result.numbers


@pytest.mark.parametrize(
    ("mean_us", "runs", "finding"),
    [(150.0, 5, CONFIRMED), (60.0, 5, REFUTED), (98.3, 5, REFUTED), (148.0, 5, UNDECIDED), (150.0, 4, UNDECIDED)],
)
def test_latency_grows_with_the_timeout(tmp_path, mean_us, runs, finding):
    """By 50 us at least: 0.3 us more are not what is claimed. At 148 us runs differ too much to tell."""
    for k in range(runs):
        spread = 3.0 * (k - 2) if finding == UNDECIDED else 0.0
        oneshot_run(tmp_path, f"a{k}", latencies(3000, 10 + k, 98.0))
        oneshot_run(tmp_path, f"b{k}", latencies(3000, 20 + k, mean_us + spread), timeout_us=10_000)
    assert examine(tmp_path, "oneshot-latency-grows-with-timeout").finding == finding


def test_where_the_peaks_lie(tmp_path):
    for k in range(12):
        oneshot_run(tmp_path / "even", f"{k}", latencies(2000, k))
        early = with_values(latencies(2000, k), *((place, 300_000) for place in range(10)))
        oneshot_run(tmp_path / "early", f"{k}", early)
    oneshot_run(tmp_path / "few", "a", latencies(2000, 1))
    assert examine(tmp_path / "even", "peaks-random").finding == CONFIRMED
    assert examine(tmp_path / "early", "peaks-random").finding == REFUTED
    assert examine(tmp_path / "few", "peaks-random").finding == UNDECIDED


def test_peaks_at_a_fixed_distance_are_a_pattern(tmp_path):
    for k in range(12):
        peaks = ((place, 300_000 + place) for place in range(77 + 100 * k, 20_000, 2000))
        oneshot_run(tmp_path, f"{k}", with_values(latencies(20_000, k), *peaks))
    result = examine(tmp_path, "peaks-random")
    assert result.finding == REFUTED and "for no period" in result.numbers


def test_a_burst_is_one_peak_and_a_message_one_measurement(tmp_path):
    rng = np.random.default_rng(3)
    for k in range(60):
        peaks = [int(start) + i for start in rng.integers(0, 19_900, 2) for i in range(5)]
        values = with_values(latencies(20_000, k), *((place, 300_000 + place) for place in peaks))
        message_run(tmp_path, f"{k}", [values, values + 1000])
    result = examine(tmp_path, "peaks-random")
    assert result.finding == CONFIRMED and "places of 1" in result.numbers and "in 60 runs" in result.numbers


def test_another_deadline_assumes_independence_and_says_so(tmp_path):
    oneshot_run(tmp_path, "a", latencies(5000, 1))
    tests = {}
    for deadline_ns in (400_000, 300_000):
        examined = examine_claims(study(tmp_path, Question(deadline_ns=deadline_ns), bounds=False))
        tests[deadline_ns] = next(claim.result.test for claim in examined if claim.id == "oneshot-400us-rare")
    assert "effective sample size" in tests[400_000] and "independence assumed" in tests[300_000]


def test_nanosleep_beside_the_timer(tmp_path):
    text = "# Histogram\n000010 002000\n000{} 000001\n# Min Latencies: 00010\n"
    text += "# Avg Latencies: 00010\n# Max Latencies: 000{}\n# Histogram Overflows: 00000\n"
    text += "# Histogram Overflow at cycle number:\n# Thread 0:\n"
    for name, most, finding in (("low", "030", CONFIRMED), ("high", "900", REFUTED)):
        root = tmp_path / name
        oneshot_run(root, "a", latencies(2001, 1))
        file = tmp_path / f"{name}.txt"
        file.write_text(text.format(most, most))
        adopt(file, root, platform=Platform.HARDWARE)
        assert examine(root, "nanosleep-better").finding == finding


@pytest.mark.parametrize(("every", "finding"), [(8, CONFIRMED), (0, REFUTED), (30, UNDECIDED)])
def test_the_negative_cluster(tmp_path, every, finding):
    lateness = latencies(20_000, 1)
    if every:
        lateness[::every] -= 900_000
    cyclic_run(tmp_path, "a", lateness, hz=1000)
    assert examine(tmp_path, "cyclic-negative-cluster").finding == finding


def test_the_first_two_periods(tmp_path):
    for k in range(3):
        cyclic_run(tmp_path / "no", f"{k}", latencies(300, k), hz=100)
        early = latencies(300, k)
        early[0] -= 9_900_000
        early[1] -= 9_900_000
        early[2:] -= 9_900_000
        cyclic_run(tmp_path / "yes", f"{k}", early, hz=100)
    assert examine(tmp_path / "yes", "cyclic-first-two-negative").finding == CONFIRMED
    assert examine(tmp_path / "no", "cyclic-first-two-negative").finding == REFUTED
    cyclic_run(tmp_path / "one", "a", latencies(300, 1), hz=100)
    assert examine(tmp_path / "one", "cyclic-first-two-negative").finding == UNDECIDED


@pytest.mark.parametrize(("drift_ns", "finding"), [(0, CONFIRMED), (20_000, REFUTED)])
def test_the_frequency_is_kept(tmp_path, drift_ns, finding):
    cyclic_run(tmp_path, "a", latencies(1000, 1) + drift_ns * np.arange(1000), hz=1000)
    assert examine(tmp_path, "cyclic-frequency-kept").finding == finding


def test_jitter_above_400_us(tmp_path):
    cyclic_run(tmp_path / "few", "a", latencies(3000, 1), hz=1000)
    assert examine(tmp_path / "few", "cyclic-400us-never").finding == UNDECIDED
    cyclic_run(tmp_path / "once", "a", with_values(latencies(3000, 1), (1500, 900_000)), hz=1000)
    assert examine(tmp_path / "once", "cyclic-400us-never").finding == REFUTED


@pytest.mark.parametrize(("spread_us", "finding"), [(30.0, CONFIRMED), (3.0, REFUTED)])
def test_above_a_kilohertz(tmp_path, spread_us, finding):
    for k in range(5):
        cyclic_run(tmp_path, f"a{k}", latencies(5000, 10 + k), hz=1000)
        cyclic_run(tmp_path, f"b{k}", latencies(5000, 20 + k, spread_us=spread_us), hz=4000)
    assert examine(tmp_path, "cyclic-degrades-above-1khz").finding == finding


@pytest.mark.parametrize(
    ("first_ns", "runs", "finding"), [(538_000, 8, CONFIRMED), (100_000, 8, REFUTED), (538_000, 2, UNDECIDED)]
)
def test_the_first_message(tmp_path, first_ns, runs, finding):
    for k in range(runs):
        message_run(tmp_path, f"{k}", [with_values(latencies(500, k, 220.0), (0, first_ns))])
    assert examine(tmp_path, "comm-first-message-worst").finding == finding


@pytest.mark.parametrize(("step_us", "finding"), [(90.0, CONFIRMED), (40.0, UNDECIDED), (-30.0, REFUTED)])
def test_more_subscribers(tmp_path, step_us, finding):
    for run in range(5):
        seeds = [10 * run + k for k in range(5)]
        message_run(tmp_path, f"a{run}", [latencies(3000, 90 + run, 320.0)])
        message_run(
            tmp_path, f"b{run}", [latencies(3000, seed, 320.0 + step_us * (k + 1)) for k, seed in enumerate(seeds)]
        )
    assert examine(tmp_path, "comm-more-subscribers-broader").finding == finding


@pytest.mark.parametrize(("mean_us", "finding"), [(203.0, CONFIRMED), (260.0, REFUTED)])
def test_a_higher_frequency(tmp_path, mean_us, finding):
    for k in range(5):
        message_run(tmp_path, f"a{k}", [latencies(3000, 10 + k, 224.0)])
        message_run(tmp_path, f"b{k}", [latencies(3000, 20 + k, mean_us)], hz=1000)
    assert examine(tmp_path, "comm-higher-frequency-faster").finding == finding


@pytest.mark.parametrize(("n", "lost", "finding"), [(4000, (), CONFIRMED), (10, (), UNDECIDED), (300, (7,), REFUTED)])
def test_lost_messages(tmp_path, n, lost, finding):
    message_run(tmp_path, "a", [latencies(n, 1)], lost=lost)
    assert examine(tmp_path, "comm-nothing-lost").finding == finding


def test_round_robin_beside_fifo(tmp_path):
    for k in range(5):
        oneshot_run(tmp_path / "same", f"r{k}", latencies(5000, k))
        oneshot_run(tmp_path / "same", f"f{k}", latencies(5000, 50 + k), policy="FIFO")
        oneshot_run(tmp_path / "apart", f"r{k}", latencies(2000, k))
        oneshot_run(tmp_path / "apart", f"f{k}", latencies(2000, 50 + k, 140.0), policy="FIFO")
    oneshot_run(tmp_path / "single", "r", latencies(2000, 1))
    oneshot_run(tmp_path / "single", "f", latencies(2000, 2, 140.0), policy="FIFO")
    assert examine(tmp_path / "same", "rr-equals-fifo").finding == CONFIRMED
    assert examine(tmp_path / "apart", "rr-equals-fifo").finding == REFUTED
    assert examine(tmp_path / "single", "rr-equals-fifo").finding == UNDECIDED


@pytest.mark.parametrize(("p_value", "finding"), [(0.03, UNDECIDED), (0.01, REFUTED)])
def test_one_pair_of_three_refutes_only_beyond_the_chance_of_three(tmp_path, monkeypatch, p_value, finding):
    for k in range(5):
        for timeout_us in (500, 1000, 2000):
            fifo_us = 140.0 if timeout_us == 1000 else 90.0
            oneshot_run(tmp_path, f"r{k}-{timeout_us}", latencies(500, k), timeout_us=timeout_us)
            oneshot_run(
                tmp_path, f"f{k}-{timeout_us}", latencies(500, 50 + k, fifo_us), policy="FIFO", timeout_us=timeout_us
            )

    def with_p_value(pair, confidence):
        comparison = compared(pair, confidence)
        return replace(comparison, p_value=p_value if comparison.answer == ComparisonAnswer.DIFFERENT else 0.5)

    monkeypatch.setattr(general, "compared", with_p_value)
    assert examine(tmp_path, "rr-equals-fifo").finding == finding


def test_a_single_cpu(tmp_path):
    target = {"name": "single", "cpus": 1}
    oneshot_run(tmp_path, "a", latencies(300, 1), target=target)
    result = examine(tmp_path, "single-cpu-shutdown-stuck")
    assert result.finding == UNDECIDED and result.runs == ("a",)


@pytest.mark.parametrize(("spread_us", "finding"), [(300.0, CONFIRMED), (2.0, REFUTED)])
def test_without_priority(tmp_path, spread_us, finding):
    for k in range(5):
        oneshot_run(tmp_path, f"a{k}", latencies(3000, 10 + k))
        oneshot_run(tmp_path, f"b{k}", latencies(3000, 20 + k, spread_us=spread_us), policy="0")
    assert examine(tmp_path, "default-priority-unpredictable").finding == finding


def test_emulated_runs_decide_what_ros_does_not_how_fast(tmp_path):
    oneshot_run(tmp_path, "a", latencies(3000, 1, 90.0), timeout_us=800, platform="emulated")
    oneshot_run(tmp_path, "b", latencies(3000, 1), policy="0", platform="emulated")
    assert examine(tmp_path, "oneshot-sub-millisecond").finding == REFUTED
    result = examine(tmp_path, "oneshot-400us-rare")
    assert result.finding == UNDECIDED and "emulated" in result.numbers
