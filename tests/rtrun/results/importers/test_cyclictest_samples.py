"""cyclictest -v: the values in their order, of the program itself and of texts that tell too little or too much."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.plan.question import Question
from rtrun.results.importers import cyclictest_samples, samples_file
from rtrun.results.importers.adopt import adopt
from rtrun.results.importers.detect import read
from rtrun.results.importers.samples_file import read_imported_samples
from rtrun.targets.inspection.platform import Platform

RING = 16_384
HEAD = """Max CPUs = 2
Online CPUs = 2
# /dev/cpu_dma_latency set to 0us
Thread 0 Interval: 1000
Thread 1 Interval: 1000
"""


def cyclictest(*options):
    program = shutil.which("cyclictest", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install rt-tests"
    command = [program, "-v", "-i", "500", "-l", "200", *options]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


def printed(*threads):
    """What cyclictest prints of these values: its counter stands still at a value of 0."""
    text = HEAD
    for thread, values in enumerate(threads):
        counter = 0
        for place, value in enumerate(values):
            counter = place if value else counter
            text += f"{thread:8}:{counter:8}:{value:8}\n"
    return text


def written(tmp_path, text):
    path = tmp_path / "v.txt"
    path.write_text(text)
    return path


@pytest.mark.root
def test_every_value_of_the_program_is_read_in_its_order(tmp_path):
    text = cyclictest("-t2", "-h", "100")
    path = written(tmp_path, text)
    imported = read(path)
    assert [thread.name for thread in imported] == ["cyclictest-t0", "cyclictest-t1"]
    lines = [[int(word) for word in line.split(":")] for line in text.splitlines() if line.count(":") == 2]
    for number, samples in enumerate(imported):
        assert samples.values_ns.tolist() == [1000 * value for thread, _, value in lines if thread == number]
        assert samples.period_ns is None and "-N" in samples.left_out[1] and "last line" in samples.left_out[-1]
    ((folder, _),) = adopt(path, tmp_path / "out", platform=Platform.HARDWARE)
    back = read_imported_samples(folder / f"cyclictest-t0{samples_file.ENDING}")
    assert back.values_ns.tolist() == imported[0].values_ns.tolist()
    assert (back.source, back.left_out, back.period_ns) == ("cyclictest", imported[0].left_out, None)
    (group,) = study(tmp_path / "out", Question(deadline_ns=10**9)).groups
    assert group.n == len(lines) and group.verdict.late == 0


def test_reports_and_archives_take_them(tmp_path, capsys):
    rng = np.random.default_rng(1)
    adopt(
        written(tmp_path, printed(*rng.integers(2, 90, (2, 500)).tolist())), tmp_path / "out", platform=Platform.VIRTUAL
    )
    assert main(["show", "--json", str(tmp_path / "out" / "v")]) == 0
    assert [result["n"] for result in json.loads(capsys.readouterr().out)["results"]] == [500, 500]
    assert main(["report", str(tmp_path / "out")]) == 0
    assert "not known: the interval" in (tmp_path / "out" / "report.html").read_text()
    assert main(["archive", "add", str(tmp_path / "out"), "--to", str(tmp_path / "archive")]) == 0
    assert main(["verify", str(tmp_path / "out" / "v")]) == 0


@pytest.mark.parametrize("values", [[0], [0, 0, 7, 0, 0, 3, 0], [5, 0, 0], [1, 2, 3]])
def test_the_counter_stands_still_at_zero(tmp_path, values):
    first, second = read(written(tmp_path, printed(values, [9])))
    assert (first.values_ns // 1000).tolist() == values and second.values_ns.tolist() == [9000]


def test_interrupts_of_the_firmware_stand_behind_the_value(tmp_path):
    first, _ = read(written(tmp_path, printed([5, 6], [1]).replace(":       6\n", ":       6       3\n")))
    assert first.values_ns.tolist() == [5000, 6000]


@pytest.mark.root
def test_every_fifth_value_is_refused(tmp_path):
    path = written(tmp_path, cyclictest("-t1", "-o", "5"))
    with pytest.raises(UsageError, match=r"v.txt:\d+: thread 0: a counter of \d+, expected \d+: .* -o left them out"):
        read(path)


GOOD = printed([5, 6, 0, 8], [3, 4])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("       0:       1:       6\n", ""), ":7: thread 0: a counter of 1, expected 0: values"),
        (GOOD.replace("       0:       0:       5\n", ""), ":6: thread 0: a counter of 1, expected 0"),
        (GOOD.replace(":       1:       4", ":       2:       4"), ":11: thread 1: a counter of 2, expected 1"),
        (GOOD.replace(":       1:       0", ":       2:       0"), ":8: thread 0: a counter of 2, expected 1"),
        (GOOD[:-1], r":11: cut off, expected 'thread: counter: value', got '1:       1:       4'"),
        (GOOD[:-12], ":11: cut off, expected"),
        (GOOD.replace(":       6\n", ":      -6\n"), ":7: expected .*, got '0:       1:      -6'"),
        (GOOD.replace(":       6\n", ":       6\nhello\n"), ":8: expected 'thread: counter: value', got 'hello'"),
        (GOOD.replace(":       6\n", ":999999999999999\n").replace("999\n", "9999\n"), ":7: expected 'thread"),
        (printed([1]), ": thread 1: no value, expected one at least of each"),
        (printed([1]).replace("       0:", "    9999:"), ": thread 9999: expected less than 8192 threads"),
        (GOOD + "# Histogram\n000005 000001\n", r":1[0-9]: cut off: no line # Min Latencies"),
        ("# Histogram\n" + GOOD, r":2: expected a bin|thread 0: no value"),
    ],
)  # fmt: skip
def test_a_text_that_tells_too_little_is_refused_with_its_line(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=message) as refused:
        read(path)
    assert str(refused.value).startswith(f"{path}:")


HISTOGRAM = """
# Histogram
000000 000001\t000000
000003 000000\t000001
000004 000000\t000002
000005 000001\t000000
000006 000001\t000000
# Min Latencies: 00000 00003
# Avg Latencies: 00004 00003
# Max Latencies: 00008 00004
# Histogram Overflows: 00001 00000
# Histogram Overflow at cycle number:
# Thread 0: 00003
# Thread 1:
"""


def test_values_and_their_histogram_agree(tmp_path):
    # One value of 4 us was measured after the last line.
    first, second = read(written(tmp_path, GOOD + HISTOGRAM))
    assert (first.values_ns.size, second.values_ns.size) == (4, 2)
    for thread, values in ((0, [5, 6, 0, 9]), (0, [5, 6, 6, 8]), (0, [5, 8, 0, 8]), (1, [3, 3])):
        threads = [[5, 6, 0, 8], [3, 4]]
        threads[thread] = values
        with pytest.raises(UsageError, match=rf"v.txt: cyclictest-t{thread}: more values of \d us than the histogram"):
            read(written(tmp_path, printed(*threads) + HISTOGRAM))
    with pytest.raises(UsageError, match=r"v.txt: values of 2 threads, but a histogram of 1"):
        text = (
            HISTOGRAM.replace("\t000000\n0", "\n0")
            .replace("\t000001", "")
            .replace("\t000002", "")
            .replace("\t000000", "")
        )
        text = (
            text.replace("00000 00003\n", "00000\n").replace("00004 00003\n", "00004\n").replace("00008 00004", "00008")
        )
        text = text.replace("00001 00000", "00001").replace("# Thread 1:\n", "")
        read(written(tmp_path, GOOD + text))
    with pytest.raises(UsageError, match=r"v.txt:22: thread 1: |v.txt:\d+: thread 1: a mean of 90"):
        read(written(tmp_path, GOOD + HISTOGRAM.replace("00004 00003\n", "00004 00090\n")))


def test_values_that_were_overwritten_before_they_were_printed_are_refused(tmp_path):
    values = np.random.default_rng(2).integers(2, 9, 3 * RING).tolist()
    assert read(written(tmp_path, printed(values, [1])))[0].values_ns.size == 3 * RING
    # Whoever read the output stood still from 5000 on, until 2000 newer values than the ring holds were measured.
    late = [*values[:5000], *values[5000 + RING : 7000 + RING], *values[7000:]]
    with pytest.raises(UsageError, match=r"thread 0: from counter 5000 on the values are those of 16384 later"):
        read(written(tmp_path, printed(late, [1])))


@pytest.mark.parametrize("pattern", [[4], [1, 2], [3, 3, 3, 9], [0, 5, 2, 0], [*range(64)], [5] * 4095 + [70]])
def test_values_that_repeat_by_themselves_are_no_overwritten_ones(tmp_path, pattern):
    values = (pattern * 2 * RING)[: 2 * RING]
    assert read(written(tmp_path, printed(values, [1])))[0].values_ns.size == 2 * RING


def test_more_lines_than_memory_holds_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(cyclictest_samples, "LINES_MAX", 9)
    with pytest.raises(UsageError, match=r"v.txt: more than 9 lines"):
        read(written(tmp_path, GOOD))
    with pytest.raises(UsageError, match=r"v.txt:12: a line of more than 262144 characters"):
        monkeypatch.setattr(cyclictest_samples, "LINES_MAX", 99)
        read(written(tmp_path, GOOD + "1" * 300_000))


def test_a_file_of_other_values_is_refused_when_it_is_read_back(tmp_path):
    ((folder, _),) = adopt(written(tmp_path, GOOD), tmp_path / "out", platform=Platform.HARDWARE)
    path = folder / f"cyclictest-t0{samples_file.ENDING}"
    rows = folder / f"cyclictest-t0{samples_file.ROWS_ENDING}"
    for wrong, message in ((np.array([[10**18 + 1]]), "a value beyond"), (np.array([1]), r"shape \(1,\), must be")):
        np.save(rows, wrong)
        with pytest.raises(UsageError, match=message):
            read_imported_samples(path)
    assert main(["show", str(folder)]) == 2
