"""The outliers of a run directory, each explained from its trace."""

import pytest
from traced import OUTPUT, SPECIMENS, head, line, specimen, switch, waking, write_traced_run

from rtfiles.errors import UsageError
from rtrun.causes.outliers import NOT_RECORDED, explain_run
from rtrun.causes.parts import Kind
from rtrun.causes.ranking import rank
from rtrun.report.causes import answer, remedies, table
from rtrun.results.record import read_record
from rtrun.targets.inspection.control_groups import ControlGroup, Throttling

ME, HOG = ("cyclic_timer_te", 1, 4), ("hog", 2, 1)


def explained(folder):
    return list(explain_run(folder, read_record(folder)))


def test_a_planted_thread_of_a_real_trace_is_named(tmp_path):
    cases = explained(write_traced_run(tmp_path, {1558: specimen(1558)}, [23166, 23175]))
    (case,) = cases
    assert (case.outlier.index, case.outlier.value_ns, case.note) == (1558, 1_721_878, "")
    assert sum(part.length_ns for part in case.parts) == 1_721_878
    assert (case.parts[0].cause.kind, case.parts[0].cause.name) == (Kind.HIGHER, "planted_hog")
    assert case.parts[0].cause.prio == 1  # real-time priority 98
    named = rank(cases).named
    assert named is not None
    assert (named.name, named.main, named.as_long) == ("planted_hog", 1, 0)
    assert named.windows == case.control.count > 2


def test_outliers_that_share_a_trace(tmp_path):
    """The second was late after the copy had begun: the trace of the first holds nothing of it."""
    shared = head(1500, 1600, 28900_000_000) + f"# in {OUTPUT}-trace-1558.txt\n"
    folder = write_traced_run(tmp_path, {1558: specimen(1558), 1600: shared}, [23166, 23175])
    assert [(case.outlier.index, bool(case.parts), case.note) for case in explained(folder)] == [
        (1558, True, ""),
        (1600, False, NOT_RECORDED),
    ]


def test_of_two_threads_that_ran_then_the_main_one_measured(tmp_path):
    """The other one held a lock, gave it free, and still runs on another CPU."""
    mate, idle = ("mate", 5, 120), ("swapper/1", 0, 120)
    text = head(500, 3, 5000) + switch(3000, idle, mate, cpu=1) + switch(4800, HOG, ME)
    text += switch(5010, ME, HOG) + switch(5020, mate, idle, cpu=1)
    (case,) = explained(write_traced_run(tmp_path, {3: text}, [1, 5]))
    assert [part.cause.name for part in case.parts if part.cause.kind is Kind.PROGRAM] == ["cyclic_timer_te"]
    # Where it is known which thread had the value, that one, whatever the main one did.
    text = text.replace("\n", " by thread 5\n", 1)
    (case,) = explained(write_traced_run(tmp_path / "known", {3: text}, [1, 5]))
    assert [part.cause.name for part in case.parts if part.cause.kind is Kind.PROGRAM] == ["mate"]


def test_a_thread_of_a_container_is_known_by_its_name(tmp_path):
    """Its own number is another one than that in the kernel's trace."""
    folder = write_traced_run(tmp_path, {1558: specimen(1558)}, [7])
    assert explained(folder)[0].parts[0].cause.name == "planted_hog"


def test_a_late_value_while_recording_was_paused(tmp_path):
    text = head(500, 3, 5000) + switch(1000, HOG, ME) + switch(9000, ME, HOG)
    (case,) = explained(write_traced_run(tmp_path, {3: text}, [1]))
    assert (case.parts, case.note) == ((), NOT_RECORDED)


def test_lost_events_are_said(tmp_path):
    text = head(500, 3, 5000) + switch(1000, HOG, ME) + line(4500, "x: y") + "CPU:0 [LOST 5 EVENTS]\n"
    text += switch(4990, HOG, ME) + line(5001, "local_timer_entry: vector=1")
    (case,) = explained(write_traced_run(tmp_path, {3: text}, [1]))
    assert case.note == "5 events were lost within"
    assert sum(part.length_ns for part in case.parts) == 500_000


# What the group of rt-group.txt had, and one with a quota that was used up in 8 of 10 periods of the run.
RT_GROUP = ControlGroup(version=1, path="/lab", rt_runtime_us=100_000, rt_period_us=1_000_000)
COUNTS = [Throttling(periods=n, throttled=n, throttled_ns=n * 10**7) for n in (5, 13)]
QUOTA_GROUP = ControlGroup(
    version=2, path="/lab", quota_us=20_000, quota_period_us=100_000, before=COUNTS[0], after=COUNTS[1]
)
TRACE_OF_GROUP = head(10_995, 3, 6640_912_995) + (SPECIMENS / "rt-group.txt").read_text()


def answered(folder):
    cases = explained(folder)
    ranking = rank(cases)
    return answer(ranking), " ".join(remedies(ranking)), " ".join(table(ranking, cases).notes)


def test_a_control_group_is_named_with_its_limit_rather_than_the_kernels(tmp_path):
    """It was throttled by the group: the kernel's own limit, a safety net, has nothing to do with it."""
    folder = write_traced_run(tmp_path / "group", {3: TRACE_OF_GROUP}, [16322], control_groups=[RT_GROUP])
    first, advice, notes = answered(folder)
    assert first.startswith(
        "throttled by the limit of control group /lab (cpu.rt_runtime_us 100000 of 1000000 us): the main cause of 1 "
    )
    assert "raise cpu.rt_runtime_us of the group" in advice and "=-1" not in advice
    assert "control group /lab leaves to real-time threads cpu.rt_runtime_us 100000 of 1000000 us" in notes
    # Without such a group it is the kernel's, whatever quota there is for other policies; the price is stated.
    kernels = write_traced_run(tmp_path / "kernel", {3: TRACE_OF_GROUP}, [16322], control_groups=[QUOTA_GROUP])
    first, advice, notes = answered(kernels)
    assert "throttled: a thread of lower priority was chosen" in first
    assert "sched_rt_runtime_us=-1" in advice and "this takes away a safety net: a real-time thread that" in advice
    assert "cpu.max 20000 of 100000 us; throttled in 8 of 8 periods, 0.08 s in all" in notes


NORMAL, BUSY, IDLE = ("cyclic_timer_te", 1, 120), ("busy", 2, 130), ("swapper/0", 0, 120)


@pytest.mark.parametrize("woken_when_idle", [False, True])
def test_a_quota_leaves_a_cpu_idle_beside_a_thread_of_policy_other(tmp_path, woken_when_idle):
    """It is no throttling of real-time threads, for whom the group has no limit."""
    text = head(80_000, 3, 90_000) + switch(1000, BUSY, NORMAL)
    if woken_when_idle:
        text += (
            switch(2000, NORMAL, IDLE)
            + waking(10_000, 1)
            + line(10_002, "sched_wakeup: comm=x pid=1 prio=120 target_cpu=000")
        )
    else:
        text += switch(9000, NORMAL, IDLE, state="R+")
    text += switch(89_990, IDLE, NORMAL) + switch(90_010, NORMAL, IDLE)
    first, advice, _ = answered(write_traced_run(tmp_path, {3: text}, [1], control_groups=[QUOTA_GROUP]))
    assert first.startswith("throttled by the limit of control group /lab (cpu.max 20000 of 100000 us): the main cause")
    assert "a real-time policy, which the quota does not touch" in advice and "=-1" not in advice


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# tracer: nop\n", "its first line does not name an outlier, as the suites write it: '# tracer: nop"),
        ("", "its first line does not name an outlier"),
        (head(1, 3, 2) + "# in ../../etc/passwd\n", r"a trace is in '../../etc/passwd', which is no file of the run"),
    ],
)
def test_a_trace_that_is_not_of_a_suite_is_refused(tmp_path, text, message):
    folder = write_traced_run(tmp_path, {3: text}, [1])
    with pytest.raises(UsageError, match=message):
        explained(folder)


def test_an_altered_trace_is_refused(tmp_path):
    folder = write_traced_run(tmp_path, {1558: specimen(1558)}, [23166])
    with (folder / f"{OUTPUT}-trace-1558.txt").open("a") as trace:
        trace.write("more\n")
    with pytest.raises(UsageError, match="altered since the run was closed"):
        explained(folder)
