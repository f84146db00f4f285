"""Files of other programs: real ones where the program runs here, broken ones everywhere."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.report.study import study
from rtrun.results.gnuplot_log import read_log
from rtrun.results.importers.adopt import adopt
from rtrun.results.importers.detect import read
from rtrun.results.importers.histogram_file import ENDING, read_histogram

LOGS_2014 = Path(__file__).parents[3] / "data" / "2014"

# As in the manual page rtla-timerlat-hist(1), cut to two CPUs, with user threads and the totals newer versions add.
TIMERLAT = """# RTLA timerlat histogram
# Time unit is microseconds (us)
# Duration:   0 00:00:02
Index   IRQ-001   Thr-001   Usr-001   IRQ-002   Thr-002   Usr-002
0          1000       944       134       999       998       986
10            0        55       863         0         1        13
20            0         1         3         0         0         0
over:         0         2         0         0         0         0
count:     1000      1002      1000       999       999       999
min:          0         3         4         0         2         3
avg:          1         7        10         0         2         3
max:          7       210        24         3        11        15
ALL:        IRQ       Thr       Usr
count:     1999      2001      1999
"""


@pytest.fixture(scope="session")
def cyclictest(tmp_path_factory):
    """Two threads, 1000 loops each, histograms too short for their values: text and JSON of the same run."""
    folder = tmp_path_factory.mktemp("cyclictest")
    program = shutil.which("cyclictest", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install rt-tests"
    command = [program, "-q", "-t2", "-i", "200", "-l", "1000", "-h", "64", f"--json={folder}/run.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    (folder / "run.txt").write_text(done.stdout)
    return folder


def test_cyclictest_tells_the_same_in_text_and_json(cyclictest):
    text, data = read(cyclictest / "run.txt"), read(cyclictest / "run.json")
    assert [one.name for one in text] == [one.name for one in data] == ["cyclictest-t0", "cyclictest-t1"]
    for a, b in zip(text, data, strict=True):
        # cyclictest ends when the faster thread is done: the other has fewer.
        assert a.histogram.n == b.histogram.n > 0
        assert a.histogram.counts.tolist() == b.histogram.counts.tolist()
        assert a.histogram.values_ns.tolist() == b.histogram.values_ns.tolist()
        assert (a.histogram.overflow, a.histogram.max_ns) == (b.histogram.overflow, b.histogram.max_ns)
        if a.histogram.overflow:
            assert a.histogram.overflow_from_ns == b.histogram.overflow_from_ns == 64_000
        assert "order" in a.left_out[0]


def test_jitterdebugger_is_read(tmp_path):
    program = shutil.which("jitterdebugger", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install jitterdebugger"
    subprocess.run([program, "-l", "500", "-p", "1", "-o", str(tmp_path)], capture_output=True, check=True, timeout=60)
    found = read(tmp_path / "results.json")
    raw = json.loads((tmp_path / "results.json").read_text())["cpu"]
    assert [one.histogram.n for one in found] == [cpu["count"] for cpu in raw.values()]
    assert [one.histogram.max_ns for one in found] == [1000 * cpu["max"] for cpu in raw.values()]


def test_timerlat_is_read_by_context(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    found = {one.name: one for one in read(file)}
    thread = found["timerlat-Thr-001"].histogram
    assert (thread.n, thread.overflow, thread.bin_ns, thread.max_ns) == (1002, 2, 10_000, 210_000)
    assert thread.values_ns.tolist() == [0, 10_000, 20_000]
    made = adopt(file, tmp_path / "out", emulated=False)
    assert [folder.name for folder, _ in made] == ["tl-interrupt", "tl-thread", "tl-user"]
    assert [group.n for group in study(tmp_path / "out").groups] == [1999, 2001, 1999]


def test_the_largest_value_decides_a_deadline_beyond_the_bins(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    adopt(file, tmp_path / "out", emulated=False)
    by_context = {g.parameters["context"]: g for g in study(tmp_path / "out", deadline_ns=400_000).groups}
    assert by_context["thread"].verdict is not None and by_context["thread"].verdict.late == 0
    by_context = {g.parameters["context"]: g for g in study(tmp_path / "out", deadline_ns=100_000).groups}
    assert by_context["thread"].verdict is None and "beyond" in str(by_context["thread"].undecidable)


@pytest.mark.parametrize("log", sorted(LOGS_2014.glob("*.log")), ids=lambda path: path.name[:30])
def test_logs_of_2014_become_runs(tmp_path, log, capsys):
    assert main(["import", str(log), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "not known: the samples" in said
    (group,) = study(tmp_path / "out").groups
    assert group.n + sum(len(one.header.startup) for one in group.digests) == int(read_log(log).count.sum())


def test_what_was_emulated_stays_so(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    assert main(["import", str(file), "--out", str(tmp_path / "out"), "--emulated"]) == 0
    assert study(tmp_path / "out").emulated


def test_one_bad_file_does_not_stop_the_others(tmp_path, capsys):
    good, bad = tmp_path / "good.txt", tmp_path / "bad.txt"
    good.write_text(TIMERLAT)
    bad.write_text("hello")
    assert main(["import", str(bad), str(good), "--out", str(tmp_path / "out")]) == 2
    assert "bad.txt: expected a log" in capsys.readouterr().err
    assert (tmp_path / "out" / "good-thread" / "run.json").exists()
    assert main(["import", str(good), "--out", str(tmp_path / "out")]) == 2
    assert "there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cut.txt", "# Histogram\n000001 000002\n", "cut off: no line # Total"),
        ("empty.txt", "# Histogram\n# Total: 0\n", "cut off: no bins"),
        (
            "sum.txt",
            "# Histogram\n000001 000002\n# Total: 3\n# Max Latencies: 1\n",
            "sum.txt:3: thread 0: a total of 3",
        ),
        ("fall.txt", "# Histogram\n000005 000002\n000004 1\n# Total: 3\n", "fall.txt:3: 4 does not rise"),
        ("nan.txt", "# Histogram\n000005 nan\n# Total: 3\n", "nan.txt:2: expected a bin"),
        ("x.json", '{"cpu": {"0": {"histogram": {"5": NaN}}}}', "NaN is no number"),
        ("y.json", '{"cpu": {"0": {"histogram": {"5": -1}, "count": 1, "max": 5}}}', "cpu.0.5|cpu.0.histogram.5"),
        ("z.json", '{"cpu": {"0": {"histogram": {"5": 9}, "count": 1, "max": 5}}}', "but the bins hold 9"),
        ("n.json", "[" * 100_000, "expected"),
        ("o.json", "{" + '"a":{' * 50_000, "not JSON"),
        ("tl.txt", TIMERLAT.replace("count:     1000", "count:     1001"), "IRQ-001: a count of 1001"),
        ("tl2.txt", TIMERLAT[: TIMERLAT.index("over:")], "cut off"),
        ("tl3.txt", TIMERLAT.replace("944       134", "944"), "tl3.txt:5: 5 values for 6 columns"),
    ],
)
def test_broken_files_are_refused_with_their_place(tmp_path, name, text, message):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(UsageError, match=message) as refused:
        read(file)
    assert name in str(refused.value)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_no_damage_crashes_a_reader(tmp_path_factory, cyclictest, data):
    """Cut, flip and insert bytes anywhere: a result or one UsageError that names the file."""
    text = data.draw(
        st.sampled_from(
            [(cyclictest / "run.txt").read_bytes(), (cyclictest / "run.json").read_bytes(), TIMERLAT.encode()]
        )
    )
    damaged = bytearray(text[: data.draw(st.integers(0, len(text)))])
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(damaged)))
        damaged[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=4))
    file = tmp_path_factory.mktemp("fuzz") / "damaged.txt"
    file.write_bytes(damaged)
    try:
        found = read(file)
    except UsageError as error:
        assert "damaged.txt" in str(error)
    else:
        assert all(one.histogram.n >= 0 for one in found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values_ns": [1, 2, 3]}, "3 values_ns, but 1 counts"),
        ({"values_ns": [2**62]}, "cannot be"),
        ({"counts": [0]}, "counts.0"),
        ({"bin_ns": 0}, "bin_ns"),
        ({"schema": 2}, "schema"),
        ({"values_ns": [2000, 1000], "counts": [1, 1]}, "must rise"),
    ],
)
def test_an_edited_histogram_file_is_refused(tmp_path, change, message):
    good = {
        "schema": 1,
        "source": "x",
        "bin_ns": 1000,
        "values_ns": [1000],
        "counts": [5],
        "overflow": 0,
        "overflow_from_ns": None,
        "max_ns": None,
        "period_ns": 1000.0,
        "left_out": [],
    }
    path = tmp_path / f"a{ENDING}"
    path.write_text(json.dumps(good))
    assert read_histogram(path).histogram.n == 5
    path.write_text(json.dumps(good | change))
    with pytest.raises(UsageError, match=message):
        read_histogram(path)
