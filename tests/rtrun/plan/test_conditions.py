"""The background programs of a condition."""

from pathlib import PurePosixPath

import pytest

from rtrun.plan import conditions
from rtrun.plan.suites import argv


def background(name, expected_s=100.0, deadline_s=620.0, **settings):
    return conditions.background(
        name,
        {key: option.default for key, option in conditions.conditions().settings.items()} | settings,
        cpus=4,
        programs={"communication_tests_publisher": "/p", "communication_tests_subscriber": "/s"},
        scripts=PurePosixPath("/scripts"),
        environment=(),
        expected_s=expected_s,
        deadline_s=deadline_s,
    )


LOADS = [name for name, condition in conditions.conditions().conditions.items() if condition.loads]


@pytest.mark.parametrize("name", LOADS)
def test_a_load_outlives_the_suite(name):
    for load in background(name):
        assert load.is_load
        assert load.program.deadline_s == 620 + conditions.OUTLIVE_S
        words = load.program.argv
        if words[0] == "stress-ng":
            # With 0, for no end, --timer ends by itself after some seconds.
            assert words[words.index("--timeout") + 1] == "920"


def test_nodes_send_for_longer_than_the_suite_measures():
    listener, talker = background("nodes", nodes_hz=10)
    for load in (listener, talker):
        words = load.program.argv
        assert words[words.index("-r") + 1] == str(10 * (2 * 100 + 120))


def test_a_load_runs_on_its_cpus_and_a_setting_is_no_load():
    pinning, load = background("cpu80", load_cpu="1-2", governor="performance")
    assert pinning.program.argv == ("/scripts/pin_setting.sh", "governor", "performance") and not pinning.is_load
    assert load.program.argv[:3] == ("taskset", "-c", "1-2")
    assert load.processes == 1 + 2


def test_a_baseline_gets_no_priority_without_a_policy():
    values = {"policy": "0", "priority": 80, "repetitions": 10}
    assert not [word for word in argv("cyclictest", "cyclictest", values) if word.startswith("--priority")]
    assert "--priority=80" in argv("cyclictest", "cyclictest", values | {"policy": "RR"})


def test_cyclictest_keeps_idle_cpus_awake_unless_it_is_told_not_to():
    words = argv("cyclictest", "cyclictest", {"cpu": "0"})
    assert "--affinity=0" in words and "--policy=other" in words, "only a policy is named otherwise"
    assert "--latency=0" in words and "--laptop" not in words
    for value, word in ((None, "--laptop"), (7, "--latency=7")):
        words = argv("cyclictest", "cyclictest", {"cpu_dma_latency_us": value})
        assert [word for word in words if word.startswith("--la")] == [word]
    assert not [word for word in words if "idle-state" in word], "older ones do not know it"
    words = argv("cyclictest", "cyclictest", {"cpu_dma_latency_us": None, "deepest_idle_state": -1})
    assert words[-2:] == ["--laptop", "--deepest-idle-state=-1"]
    assert argv("cyclic_timer_tests", "cyclic_timer_tests", {"cpu_dma_latency_us": 0})[1:] == ["--cpu-dma-latency", "0"]
