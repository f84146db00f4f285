"""`trace` of a campaign: the limit, the untraced twin, the warm-up that finds a quantile."""

import pytest

from rtfiles.errors import UsageError
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import digest_of

CYCLIC = {"suite": "cyclic_timer_tests", "frequency_hz": 1000, "repetitions": 20_000}


def runs_of(*entries, **campaign):
    return plan(Campaign(schema=1, name="c", runs=[*entries], **campaign), "c.yml")


def test_each_traced_run_has_an_untraced_twin_measured_in_turn_with_it():
    runs = runs_of({**CYCLIC, "trace": {"above": "300us"}, "repeats": 3})
    assert [(run.repeat, run.trace) for run in runs] == [
        (1, "off"), (1, "300us"), (2, "300us"), (2, "off"), (3, "off"), (3, "300us"),
    ]  # fmt: skip
    for run in runs:
        assert run.parameters["trace_threshold_us"] == (None if run.trace == "off" else 300)
    assert len({tuple(sorted((run.parameters | {"trace_threshold_us": 0}).items())) for run in runs}) == 1
    assert runs[0].name.endswith("-trace-off") and runs[1].name.endswith("-trace-300us")


def test_a_quantile_has_a_short_warm_up_right_before_each_run():
    runs = runs_of({**CYCLIC, "trace": {"above": "p99.9"}, "repeats": 2}, order="interleaved", seed=3)
    assert len(runs) == 6
    for run, before in zip(runs[1:], runs[:-1], strict=True):
        if run.trace == "p99.9":
            assert before.name == f"{run.name}.warm-up" and before.trace == ""
            assert run.parameters["trace_threshold_us"] is None, "it is not known yet"
            asked = {"repetitions": 10_000, "trace_threshold_us": 60_000_000}
            assert before.parameters == {**run.parameters, **asked}


def test_a_warm_up_is_no_longer_than_its_run_and_long_enough_to_be_observed():
    entry = {**CYCLIC, "repetitions": 5000, "trace": {"above": "p90"}}
    assert next(run for run in runs_of(entry) if "warm-up" in run.name).parameters["repetitions"] == 100
    loaded = next(run for run in runs_of({**entry, "condition": "cpu80"}) if "warm-up" in run.name)
    assert loaded.parameters["repetitions"] == 5000, "0.1 s are too short to see the load in effect"


@pytest.mark.parametrize(
    ("above", "text", "threshold_us"),
    [("1ms", "1000us", 1000), ("60s", "60000000us", 60_000_000), ("p99.90", "p99.9", None), ("p50", "p50", None)],
)
def test_forms_of_the_limit(above, text, threshold_us):
    run = next(run for run in runs_of({**CYCLIC, "trace": {"above": above}}) if run.trace == text)
    assert run.parameters["trace_threshold_us"] == threshold_us


@pytest.mark.parametrize("above", ["300", "p100", "p49", "p99.9%", "0us", "1.5us", "61s", "-1us", "p99,9", ""])
def test_a_limit_that_is_none_is_refused_with_what_is_allowed(above):
    with pytest.raises(UsageError) as refused:
        runs_of({**CYCLIC, "trace": {"above": above}})
    assert str(refused.value) == (
        "c.yml: runs.0.trace.above: takes a time in whole microseconds up to 60s, as 300us, or a quantile from p50 up, "
        f"as p99.9; got {above!r}"
    )


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"trace": "p99.9"}, "c.yml: runs.0.trace: expected a mapping with the keys above"),
        ({"trace": {"over": "1ms"}}, "c.yml: runs.0.trace: unknown key 'over', allowed: above"),
        ({"trace": {"above": 300}}, "c.yml: runs.0.trace.above: takes a text, got 300"),
        ({"trace_threshold_us": 300}, "c.yml: runs.0.trace_threshold_us: write trace: {above: 300us}, or a quantile"),
        (
            {"trace": {"above": "p99.9"}, "repetitions": 500},
            "c.yml: cyclic_timer_tests measures 500 values; none is expected above p99.9: trace.above takes "
            "repetitions of 1000 or more for it",
        ),
    ],
)
def test_what_is_wrong_is_said(entry, message):
    with pytest.raises(UsageError) as refused:
        runs_of({**CYCLIC, **entry})
    assert message in str(refused.value)


def test_the_old_key_in_common_is_refused_with_what_to_write():
    with pytest.raises(UsageError, match=r"common.trace_threshold_us: write trace: \{above: 300us\}"):
        runs_of(CYCLIC, common={"trace_threshold_us": 300})


UNTIL = {"deadline": "400us", "probability": "1e-6", "at_most": "1h"}


@pytest.mark.parametrize(
    ("until", "common", "series"),
    [({"of": "jitter"}, {}, "jitter"), ({}, {}, "lateness"), ({"of": "jitter"}, {"trace_of": "lateness"}, "lateness")],
)
def test_what_is_judged_is_what_traces_are_of(until, common, series):
    (run,) = runs_of(CYCLIC, until=UNTIL | until, common=common, order="interleaved", seed=1)
    assert run.parameters["trace_of"] == series


def test_a_goal_takes_no_trace():
    with pytest.raises(UsageError, match="until: takes no trace"):
        runs_of({**CYCLIC, "trace": {"above": "1ms"}}, until=UNTIL, order="interleaved", seed=1)


def test_a_twin_can_be_left_out():
    (run,) = runs_of({**CYCLIC, "trace": {"above": "1ms"}}, exclude=[{"trace": "off"}])
    assert run.trace == "1000us"


def test_a_baseline_in_the_same_campaign_ignores_a_common_trace():
    runs = runs_of(CYCLIC, {"suite": "cyclictest"}, common={"trace": {"above": "1ms"}})
    assert [run.trace for run in runs] == ["off", "1000us", ""]


def test_a_campaign_without_traces_is_the_one_that_it_was():
    (plain,) = runs_of(CYCLIC)
    assert plain.trace == ""
    assert digest_of([plain]) != digest_of(runs_of({**CYCLIC, "trace": {"above": "1ms"}}))
