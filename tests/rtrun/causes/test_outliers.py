"""The outliers of a run directory, each explained from its trace."""

import pytest
from traced import OUTPUT, head, line, specimen, switch, write_traced_run

from rtfiles.errors import UsageError
from rtrun.causes.outliers import NOT_RECORDED, explain_run
from rtrun.causes.parts import Kind
from rtrun.causes.ranking import rank
from rtrun.results.record import read_record

ME, HOG = ("cyclic_timer_te", 1, 4), ("hog", 2, 1)


def explained(folder):
    return list(explain_run(folder, read_record(folder)))


def test_a_planted_thread_of_a_real_trace_is_named(tmp_path):
    made = explained(write_traced_run(tmp_path, {1558: specimen(1558)}, [23166, 23175]))
    (one,) = made
    assert (one.outlier.index, one.outlier.value_ns, one.note) == (1558, 1_721_878, "")
    assert sum(part.length_ns for part in one.parts) == 1_721_878
    assert (one.parts[0].cause.kind, one.parts[0].cause.name) == (Kind.HIGHER, "planted_hog")
    assert one.parts[0].cause.prio == 1  # real-time priority 98
    named = rank(made).named
    assert named is not None
    assert (named.name, named.main, named.as_long) == ("planted_hog", 1, 0)
    assert named.windows == one.control.count > 2


def test_outliers_that_share_a_trace(tmp_path):
    """The second was late after the copy had begun: the trace of the first holds nothing of it."""
    shared = head(1500, 1600, 28900_000_000) + f"# in {OUTPUT}-trace-1558.txt\n"
    folder = write_traced_run(tmp_path, {1558: specimen(1558), 1600: shared}, [23166, 23175])
    assert [(one.outlier.index, bool(one.parts), one.note) for one in explained(folder)] == [
        (1558, True, ""),
        (1600, False, NOT_RECORDED),
    ]


def test_of_two_threads_that_ran_then_the_main_one_measured(tmp_path):
    """The other one held a lock, gave it free, and still runs on another CPU."""
    mate, idle = ("mate", 5, 120), ("swapper/1", 0, 120)
    text = head(500, 3, 5000) + switch(3000, idle, mate, cpu=1) + switch(4800, HOG, ME)
    text += switch(5010, ME, HOG) + switch(5020, mate, idle, cpu=1)
    (one,) = explained(write_traced_run(tmp_path, {3: text}, [1, 5]))
    assert [part.cause.name for part in one.parts if part.cause.kind is Kind.PROGRAM] == ["cyclic_timer_te"]


def test_a_thread_of_a_container_is_known_by_its_name(tmp_path):
    """Its own number is another one than that in the kernel's trace."""
    folder = write_traced_run(tmp_path, {1558: specimen(1558)}, [7])
    assert explained(folder)[0].parts[0].cause.name == "planted_hog"


def test_a_late_value_while_recording_was_paused(tmp_path):
    text = head(500, 3, 5000) + switch(1000, HOG, ME) + switch(9000, ME, HOG)
    (one,) = explained(write_traced_run(tmp_path, {3: text}, [1]))
    assert (one.parts, one.note) == ((), NOT_RECORDED)


def test_lost_events_are_said(tmp_path):
    text = head(500, 3, 5000) + switch(1000, HOG, ME) + line(4500, "x: y") + "CPU:0 [LOST 5 EVENTS]\n"
    text += switch(4990, HOG, ME) + line(5001, "local_timer_entry: vector=1")
    (one,) = explained(write_traced_run(tmp_path, {3: text}, [1]))
    assert one.note == "5 events were lost within"
    assert sum(part.length_ns for part in one.parts) == 500_000


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
