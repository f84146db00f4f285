"""What was asked for, compared with what sample.sh observed."""

import io
from dataclasses import replace
from pathlib import PurePosixPath

import pytest
from written import write_cyclic

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtrun.plan import conditions
from rtrun.plan.campaign import Campaign, plan
from rtrun.results.output import Record
from rtrun.validity.observations import read_observations, summarize
from rtrun.validity.requirements import find_unseen_option, find_violation, measuring_threads, requested

STAT = "cpu {busy} 0 0 {idle} 0 0 0 0 0 0"


def read(text):
    return read_observations(io.StringIO(text))


def sample(at_s, *block, until_s=None, busy=0, idle=0):
    lines = [f"at {at_s} 0.50 - 700000,920000 {STAT.format(busy=busy, idle=idle)}"]
    return "\n".join([*lines, *block, *([f"end {until_s or at_s}"] if block else [])]) + "\n"


def thread(policy=2, priority=95, cpus="0-1", program="cyclic_timer_tests"):
    return f"thread {program} 7 {policy} {priority} {cpus} cyclic timer"


def run_of(**values):
    entry = {"suite": "cyclic_timer_tests", "policy": "RR", "frequency_hz": 10, "repetitions": 1000} | values
    return plan(Campaign(schema=1, name="test", runs=[entry]), "test")[0]


def background(run):
    return conditions.background(
        run.condition,
        run.settings,
        cpus=2,
        programs={},
        scripts=PurePosixPath("/s"),
        environment=(),
        expected_s=run.expected_s,
        deadline_s=100,
    )


def wrong(run, *looks):
    return find_violation(run, background(run), read("".join(looks)), {})


def observed(run, *looks):
    observations = read("".join(looks))
    return summarize(observations, measuring_threads(run, observations, {}))


def test_what_is_as_asked_for():
    looks = (sample(100, thread(), thread(), "governor -", "sched_rt_runtime_us 950000"), sample(102), sample(104))
    assert wrong(run_of(), *looks) is None
    in_effect = observed(run_of(), *looks)
    assert (in_effect.policy, in_effect.priority, in_effect.cpus, in_effect.observations) == (["RR"], [95], [0, 1], 3)
    assert in_effect.sched_rt_runtime_us == [950000] and in_effect.frequency_khz == [700000, 920000]
    assert requested(run_of(), []).policy == "RR" and requested(run_of(policy=0), []).priority == 0


@pytest.mark.parametrize("other", [thread(0, 0), thread(1, 95), thread(2, 94)])
def test_a_policy_or_priority_that_was_lost_in_the_middle(other):
    assert wrong(run_of(), sample(100, thread()), sample(102, other)) is not None
    assert wrong(run_of(), sample(100, thread()), sample(102, thread(), other)) is not None, "every thread"


def test_a_policy_that_never_was(tmp_path):
    looks = read(sample(100, thread(0, 0)) + sample(102))
    record = read_json(write_cyclic(tmp_path), Record)
    assert find_violation(run_of(), [], looks, {"x": record}) is None, (
        "a program that starts, and says itself what it had"
    )
    assert wrong(run_of(), sample(100, thread(0, 0)), sample(102)) == (
        "asked for RR 95, in effect was OTHER 0 on CPUs 0,1 in each of 2 observations"
    )
    assert wrong(run_of(), sample(100, thread(0, 0)), sample(112)) == (
        "cyclic_timer_tests: asked for RR 95, after 12 s in effect was OTHER 0 on CPUs 0,1"
    )


def test_the_thread_of_a_middleware_that_is_not_as_asked_for_is_named(tmp_path):
    record = read_json(write_cyclic(tmp_path), Record)
    threads = record.in_effect.threads
    of_middleware = [
        threads[0].model_copy(update={"name": name, "policy": "OTHER", "priority": 0})
        for name in ("dds.ev.0", "recvUC")
    ]
    in_effect = record.in_effect.model_copy(update={"threads": [*threads, *of_middleware]})
    says = find_violation(run_of(), [], [], {"x": record.model_copy(update={"in_effect": in_effect})})
    assert says.endswith("OTHER 0 on CPUs 0,1 (not so: dds.ev.0, recvUC; threads of roscpp take it from the process)")
    measuring = run_of(rt_scope="measuring-thread")
    assert find_violation(measuring, [], [], {"x": record.model_copy(update={"in_effect": in_effect})}) is None


def test_what_was_seen_is_told_however_short_the_run():
    run = run_of(priority=80, repetitions=30)
    assert wrong(run, sample(100, thread(2, 95)), sample(102)) == (
        "asked for RR 80, in effect was RR 95 on CPUs 0,1 in each of 2 observations"
    )
    run = run_of(policy=0, cpu="1", repetitions=30)
    assert wrong(run, sample(100, thread(0, 0))) == (
        "asked for OTHER 0 on CPUs 1, in effect was OTHER 0 on CPUs 0,1 in each of 1 observations"
    )


@pytest.mark.parametrize(
    "option", [{"clock": "monotonic"}, {"rt_scope": "measuring-thread"}, {"trace_threshold_us": 200}]
)
def test_an_option_that_nobody_can_see_in_effect(option):
    """The programs of 2014 ignore what they do not know."""
    run = replace(run_of(), parameters={**run_of().parameters, **option})
    ((name, value),) = option.items()
    assert find_unseen_option(run, {}).startswith(f"asked for {name} {value}, but nobody can see it in effect")
    assert find_unseen_option(run, option) is None, "the program says that it knows it"
    assert find_unseen_option(run_of(priority=80, cpu="1"), {}) is None, "observed from outside"
    assert find_unseen_option(run_of(repetitions=7), {}) is None, "known in 2014"


def test_what_a_middleware_says_of_itself(tmp_path):
    run = run_of(middleware="rcl", rmw="rmw_x_cpp", domain_id=7)
    record = read_json(write_cyclic(tmp_path), Record)

    def violation(**facts):
        in_effect = record.in_effect.model_copy(update={"facts": facts})
        return find_violation(run, [], [], {"x": record.model_copy(update={"in_effect": in_effect})})

    assert violation() is None and violation(rmw="rmw_x_cpp", domain_id="7", rcl_version="1.2.3") is None
    assert violation(rmw="rmw_y_cpp") == "x: asked for rmw rmw_x_cpp, in effect was rmw_y_cpp"
    assert violation(domain_id="") == "x: asked for domain_id 7, in effect was none"


def test_what_nobody_saw_is_not_taken_for_good():
    assert wrong(run_of(policy=0)) is None, "nothing was asked for"
    assert wrong(run_of(policy=0, cpu="1")).startswith("nobody saw OTHER 0 on CPUs 1 in effect")
    assert wrong(run_of(policy=0, condition="cpu80")).startswith("nobody saw condition cpu80 in effect")


def test_a_program_gives_its_priority_up_when_it_has_measured():
    run = run_of(repetitions=30)
    looks = (sample(100, thread()), sample(103, thread(0, 0)))
    assert wrong(run, *looks) is None
    assert observed(run, *looks).policy == ["RR"], "while it measured"
    assert wrong(run, sample(100, thread()), sample(100.5, thread(0, 0))) is not None


def test_a_program_that_ended_while_a_busy_target_was_observed():
    """After 15 of 20 s the sampler began to read, and found it without priority and CPUs when it had measured."""
    run, ended = run_of(repetitions=200), thread(0, 0, cpus="-")
    assert wrong(run, sample(100, thread()), sample(115, ended, until_s=121)) is None
    assert wrong(run, sample(100, thread()), sample(115, ended, until_s=116)) is not None


def test_a_run_that_stopped_early_gave_its_priority_up_early(tmp_path):
    record = read_json(write_cyclic(tmp_path), Record).model_copy(update={"complete": False})
    looks = [sample(100, thread()), sample(102), sample(104, thread(0, 0))]
    run = run_of()
    assert wrong(run, *looks) is not None
    assert find_violation(run, background(run), read("".join(looks)), {"x": record}) is None
    looks.append(sample(106, thread()))
    assert find_violation(run, background(run), read("".join(looks)), {"x": record}) is not None, "it came back"


def test_a_run_without_policy_must_not_have_one():
    assert wrong(run_of(policy=0), sample(100, thread(0, 0)), sample(102, thread())) is not None


def test_affinity():
    assert wrong(run_of(cpu="1"), sample(100, thread(cpus="1")), sample(102)) is None
    assert "on CPUs 0,1" in wrong(run_of(cpu="1"), sample(100, thread(cpus="1")), sample(102, thread()))


def test_only_the_measuring_thread():
    run = run_of(rt_scope="measuring-thread")
    assert wrong(run, sample(100, thread(), thread(0, 0)), sample(112)) is None
    assert wrong(run, sample(100, thread(0, 0), thread(0, 0)), sample(112)) is not None


def test_the_main_thread_of_cyclictest_only_waits():
    (run,) = plan(
        Campaign(
            schema=1,
            name="test",
            runs=[{"suite": "cyclictest", "policy": "RR", "interval_us": 100_000, "threads": 2, "repetitions": 1000}],
        ),
        "test",
    )
    measuring = thread(program="cyclictest")
    main = thread(0, 0, program="cyclictest")
    assert wrong(run, sample(100, main, measuring, measuring), sample(112)) is None
    assert wrong(run, sample(100, main, measuring), sample(112)) is not None


def test_a_load_with_too_few_workers():
    run = run_of(condition="cpu80")
    assert wrong(run, sample(100, thread(), "load stress 3 0-1"), sample(102)) is None
    assert wrong(run, sample(100, thread(), "load stress 3 0-1"), sample(102, thread(), "load stress 2 0-1")) == (
        "condition cpu80: stress had 2 of 3 processes while the suite ran"
    )
    assert "0 of 3" in wrong(run, sample(100, thread()))
    after_the_suite = sample(102, "load stress 1 0-1")
    assert wrong(run, sample(100, thread(), "load stress 3 0-1"), after_the_suite) is None


def test_what_is_kept_of_a_load_is_its_fewest_processes():
    looks = [
        sample(100, thread(), "load stress 4 0-1"),
        sample(102, thread(), "load stress 3 1"),
        sample(104, thread()),
    ]
    assert observed(run_of(condition="cpu80"), *looks[:2]).loads == {"stress": 3}
    kept = observed(run_of(condition="cpu80"), *(look + "end\n" for look in looks))
    assert (kept.loads, kept.load_cpus, kept.observations) == ({"stress": 0}, [0, 1], 3), "it was gone in the end"


def test_a_load_that_does_nothing():
    run = run_of(condition="cpu80")
    block = (thread(), "load stress 3 0-1")
    assert wrong(run, sample(100, *block, busy=0, idle=0), sample(110, busy=81, idle=19)) is None
    assert wrong(run, sample(100, *block, busy=0, idle=0), sample(110, busy=10, idle=90)) == (
        "condition cpu80: the CPUs were 10.0 % busy, below 60 %"
    )


def test_a_load_on_other_cpus():
    run = run_of(condition="cpu80", load_cpu="1")
    assert background(run)[0].program.argv[:3] == ("taskset", "-c", "1")
    assert background(run)[0].processes == 2, "one CPU, one worker"
    assert wrong(run, sample(100, thread(), "load stress 2 1"), sample(102)) is None
    assert "ran on CPUs [0, 1], not on [1]" in wrong(run, sample(100, thread(), "load stress 2 0-1"))


def test_a_governor_that_changed():
    run = run_of(governor="performance")
    pinned = "load hold-governor 1 0-1"
    assert wrong(run, sample(100, thread(), pinned, "governor performance,performance")) is None
    assert "in effect was ondemand" in wrong(run, sample(100, thread(), pinned, "governor performance,ondemand"))


NINES = "9" * 6000
HEAD = "at 1 0.5 - - cpu 1 2 3 4 5 6 7 8\n"


@pytest.mark.parametrize(
    "line",
    [
        "at",
        "at x y",
        "end",
        "thread a",
        "at 1 2 - - cpu 1 2 3 4",
        HEAD.replace("1 0.5", "inf 0.5"),
        HEAD.replace("1 0.5", "1 nan"),
        HEAD.replace("- -", "- ²"),
        HEAD.replace("cpu 1", f"cpu {NINES}"),
        HEAD + f"thread x 7 {NINES} 95 0 y",
        HEAD + f"thread x 7 2 {NINES} 0 y",
        HEAD + "thread x 7 77 95 0 y",
        HEAD + "thread x 7 2 95 0-999999999 y",
        HEAD + "thread x 7 2 95 0, y",
        HEAD + f"load x {NINES} 0",
        HEAD + f"rival 7 2 {NINES} y",
        HEAD + f"sched_rt_runtime_us {NINES}",
    ],
)
def test_what_sample_sh_never_wrote(line):
    with pytest.raises(UsageError, match=r"sampler.stdout:\d: not what sample.sh writes"):
        read(f"{line}\nend\n")


def test_a_last_line_that_was_cut_off():
    assert len(read(sample(100, thread()) + "at 10")) == 1
