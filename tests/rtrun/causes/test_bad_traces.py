"""Traces that are not what they should be: cut off, torn, overwritten, of another clock, of other tools."""

import pytest
from traced import head, line, specimen, switch, waking, write_traced_run

from rtfiles.errors import UsageError
from rtrun.causes.outliers import EMPTY, NO_TIMES, NOT_RECORDED, explain_run
from rtrun.causes.parts import Kind
from rtrun.cli import main
from rtrun.results.record import read_record

ME, HOG = ("cyclic_timer_te", 1, 4), ("hog", 2, 1)
HEAD = head(500, 3, 5000)
SECOND_US = 10**6


def explain(folder, text, tids=(1,)):
    (explained,) = explain_run(write_traced_run(folder, {3: text}, tids), read_record(folder / "001-run"))
    assert not explained.parts or sum(part.length_ns for part in explained.parts) == explained.outlier.value_ns
    return explained


@pytest.mark.parametrize("part", [0.01, 0.3, 0.5, 0.7, 0.9, 0.999])
def test_cut_off_anywhere(part, tmp_path):
    """The target's disk was full, or the copy was interrupted."""
    text = specimen(1558)
    explained = explain(tmp_path, text[: int(part * len(text))], (23166, 23175))
    assert explained.parts or explained.note == NOT_RECORDED or explained.note == NO_TIMES


def test_torn_lines_of_two_writers_are_left_out(tmp_path):
    lines = specimen(1558).splitlines(keepends=True)
    for place in range(400, len(lines) - 1, 7):
        lines[place] = lines[place][:40] + lines[place + 1]
    explained = explain(tmp_path, "".join(lines), (23166, 23175))
    assert explained.outlier.value_ns == 1_721_878


def test_a_cpu_whose_buffer_begins_after_the_moment_is_unexplained_until_then(tmp_path):
    """The buffers of the CPUs wrap one by one: the older part of this one was overwritten."""
    text = HEAD + line(4000, "x: y", cpu=1) + "##### CPU 0 buffer started ####\n"
    text += switch(4800, HOG, ME) + line(5001, "local_timer_entry: vector=1")
    explained = explain(tmp_path, text)
    assert [(part.cause.kind, part.length_ns) for part in explained.parts] == [
        (Kind.UNEXPLAINED, 300_000),
        (Kind.PROGRAM, 200_000),
    ]


def test_a_buffer_that_was_overwritten_since_is_said(tmp_path):
    text = HEAD + switch(9000, HOG, ME) + switch(9500, ME, HOG)
    assert explain(tmp_path, text).note == NOT_RECORDED


@pytest.mark.parametrize(
    ("missing", "note"),
    [
        ("CPU:0 [LOST 7 EVENTS]", "; 7 events were lost within\n"),
        ("CPU:0 [LOST EVENTS]", "; events were lost within\n"),
        ("no line of a trace", "; 1 line of its trace could not be read\n"),
    ],
)
def test_what_is_missing_is_said_with_the_outlier(missing, note, tmp_path, capsys):
    text = HEAD + switch(4000, HOG, ME) + f"{missing}\n" + switch(4900, HOG, ME)
    write_traced_run(tmp_path, {3: text + line(5001, "local_timer_entry: vector=1")}, [1])
    assert main(["why", str(tmp_path)]) == 0
    assert note in capsys.readouterr().out


@pytest.mark.parametrize("begin_us", [7 * 3600 * SECOND_US, 300 * 3600 * SECOND_US])
def test_times_of_another_clock_are_said(begin_us, tmp_path):
    """trace_clock local begins with the boot of the host's kernel, global elsewhere."""
    text = HEAD + switch(begin_us, HOG, ME) + switch(begin_us + 5000, ME, HOG)
    hours = begin_us // SECOND_US // 3600
    assert explain(tmp_path, text).note == (
        f"the trace is of another clock than CLOCK_MONOTONIC_RAW, which is {hours} h away from it"
    )


@pytest.mark.parametrize(
    "text",
    [
        "            bash-1977  [000] ..... 123456789012: sched_waking: comm=x pid=1 prio=4 target_cpu=000\n",
        " 0)   0.321 us    |  mutex_lock();\n 0)               |  vfs_read() {\n",
        "not a trace\n\x00\xff\n",
    ],
    ids=["a clock that counts", "function_graph", "anything"],
)
def test_a_file_without_times_in_seconds_is_said(text, tmp_path):
    assert explain(tmp_path, HEAD + text).note == NO_TIMES


def test_an_empty_trace_is_said_and_what_to_raise_where_most_are(tmp_path, capsys):
    """It is no trace of another clock."""
    texts = dict.fromkeys((3, 4), HEAD + "# tracer: nop\n#\n\n")
    folder = write_traced_run(tmp_path, texts, [1])
    assert [explained.note for explained in explain_run(folder, read_record(folder))] == [EMPTY, EMPTY]
    assert main(["why", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "2 outliers without parts: the trace is empty" in out and "raise the limit of the campaign" in out


@pytest.mark.parametrize(
    "event",
    [
        "sched_switch:         hog:2 [1] R ==> cyclic_timer_te:1 [4]",  # trace-cmd report
        "mutex_lock <-vfs_read",  # the function tracer
        "my_driver: whatever=1",
    ],
)
def test_events_that_are_not_known_explain_nothing(event, tmp_path):
    text = HEAD + line(4000, event) + line(4900, event) + line(5001, event)
    explained = explain(tmp_path, text)
    assert not explained.parts or {part.cause.kind for part in explained.parts} == {Kind.UNEXPLAINED}


def test_a_file_of_trace_cmd_in_a_run_or_by_itself_is_refused_with_a_hint(tmp_path, capsys):
    data = "\x17\x08Dtracing6\0\0\0"
    folder = write_traced_run(tmp_path, {3: data}, [1])
    with pytest.raises(UsageError, match="a file of trace-cmd; the kernel's text is read here"):
        list(explain_run(folder, read_record(folder)))
    path = tmp_path / "trace.dat"
    path.write_text(data)
    assert main(["why", str(path)]) == 2
    assert "trace.dat: a file of trace-cmd; the kernel's text is read here" in capsys.readouterr().err


def test_a_wake_up_before_the_first_switch_of_its_cpu(tmp_path):
    text = HEAD + waking(4600, 1, by=2) + switch(4700, HOG, ME) + line(5001, "local_timer_entry: vector=1")
    assert explain(tmp_path, text).parts[-1].cause.kind is Kind.PROGRAM
