"""suites.yml as the runner sees it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtfiles.errors import UsageError
from rtrun.plan.suites import argv, check, log_names, output_name, read_log_name, suite, suites


def test_every_default_is_a_value_its_option_takes() -> None:
    for key, option in suites().options.items():
        assert check(key, option.default, key) == option.default


def test_argv_leaves_out_defaults_none_and_what_the_program_does_not_take() -> None:
    parameters = {"policy": "RR", "repetitions": 50, "frequency_hz": 1000, "idle_timeout_s": 3, "break_trace_us": None}
    assert argv("communication_tests", "communication_tests_publisher", parameters) == [
        "communication_tests_publisher", "-s", "RR", "-r", "50",
    ]  # fmt: skip
    assert argv("communication_tests", "communication_tests_subscriber", parameters) == [
        "communication_tests_subscriber", "-s", "RR", "-r", "50", "--idle-timeout", "3",
    ]  # fmt: skip
    assert argv("cyclic_timer_tests", "cyclic_timer_tests", {}) == ["cyclic_timer_tests"]


def test_names_are_those_of_2014() -> None:
    output = output_name("oneshot_timer_tests", {"policy": "FIFO", "busy_mode": 1, "prefix": "a/b_"})
    assert log_names("oneshot_timer_tests", output) == [
        f"a/b_oneshot_timer_tests_l1000_tm1000-tnRTFIFO-bm-{log}.log" for log in ("measured", "reported", "diff")
    ]
    output = output_name("cyclic_timer_tests", {"repetitions": 7})
    assert log_names("cyclic_timer_tests", output) == ["cyclic_timer_tests_l7_fq1000.log"]
    assert output_name("communication_tests", {"payload_bytes": 10000}) == "ct_gnuplot_l1000_fq1000_pl10000"


@given(
    name=st.sampled_from(sorted(suites().suites)),
    policy=st.sampled_from(["0", "RR", "FIFO"]),
    repetitions=st.integers(1, 10**8),
    frequency_hz=st.integers(1, 10**5),
    busy_mode=st.integers(0, 1),
    prefix=st.text("ab_-.19lct", max_size=8),
)
def test_a_log_name_gives_back_its_parameters(name: str, prefix: str, **parameters: str | int) -> None:
    given_parameters = {key: value for key, value in parameters.items() if key in suite(name).parameters}
    for log_name in log_names(name, output_name(name, given_parameters | {"prefix": prefix})):
        facts = read_log_name(log_name)
        assert facts is not None
        assert facts.suite == name
        assert facts.parameters.get("prefix", "") == prefix
        visible = {key: value for key, value in given_parameters.items() if f"{{{key}}}" in suite(name).output}
        assert facts.parameters | visible | {"policy": given_parameters["policy"]} == facts.parameters


def test_a_foreign_name_is_no_log_name() -> None:
    assert read_log_name("console.log") is None
    assert read_log_name("oneshot_timer_tests_l10_tm1000.log") is None  # one of three series is always named
    assert read_log_name("cyclic_timer_tests_l99999999999999999999_fq1.log") is None


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("repetitions", -1, "a whole number from 1 to 100000000, got -1"),
        ("repetitions", True, "got True"),
        ("repetitions", "10", "got '10'"),
        ("repetitions", None, "got None"),
        ("policy", "EDF", "one of 0, RR, FIFO, got 'EDF'"),
        ("policy", False, "got False"),
        ("prefix", "a\nb", "one line of text"),
        ("timeout", 5, "unknown parameter 'timeout', did you mean 'timeout_us'? known: policy, repetitions"),
    ],
)
def test_a_wrong_value_is_refused_and_told_what_is_right(key: str, value: object, message: str) -> None:
    with pytest.raises(UsageError) as error:
        check(key, value, f"campaign.yml: runs.0.{key}")
    assert str(error.value).startswith(f"campaign.yml: runs.0.{key}: ")
    assert message in str(error.value)


def test_yaml_numbers_are_taken_for_a_choice() -> None:
    assert check("policy", 0, "x") == "0"
    assert check("break_trace_us", None, "x") is None


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="unknown suite 'twoshot', known: oneshot_timer_tests"):
        output_name("twoshot", {})
    with pytest.raises(UsageError, match="unknown program 'x' of cyclic_timer_tests, known: cyclic_timer_tests"):
        argv("cyclic_timer_tests", "x", {})
