"""Files of other programs: real ones where the program runs here, broken ones everywhere."""

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from logs import LOGS_2014
from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS, Question
from rtrun.results.gnuplot_log import read_log
from rtrun.results.importers import counts
from rtrun.results.importers.adopt import adopt
from rtrun.results.importers.cyclictest import read_text
from rtrun.results.importers.detect import read
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.targets.inspection.platform import Platform

HARDWARE = ("--platform", "hardware")

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
min:          0         2         3
avg:          0         4         6
max:          7       210        24
"""


@pytest.fixture(scope="session")
def cyclictest(tmp_path_factory):
    """Two threads, 1000 loops each, histograms too short for their values: text and JSON of the same run."""
    folder = tmp_path_factory.mktemp("cyclictest")
    program = shutil.which("cyclictest", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install rt-tests"
    command = [program, "-q", "-t2", "-i", "200", "-l", "1000", "-h", "64", f"--json={folder}/run.json"]
    while True:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        (folder / "run.txt").write_text(done.stdout)
        # On a busy machine one thread may end before the other one has measured anything, which is no JSON then.
        if "nan" not in (folder / "run.json").read_text():
            return folder


@pytest.mark.root
def test_cyclictest_tells_the_same_in_text_and_json(cyclictest):
    text, data = read(cyclictest / "run.txt"), read(cyclictest / "run.json")
    assert [thread.name for thread in text] == [thread.name for thread in data] == ["cyclictest-t0", "cyclictest-t1"]
    assert 1000 in [thread.histogram.n for thread in text]
    for a, b in zip(text, data, strict=True):
        # cyclictest ends when the faster thread is done, and the other one may add values between the two outputs.
        if max(a.histogram.n, b.histogram.n) < 1000:
            continue
        assert a.histogram.n == b.histogram.n
        assert a.histogram.counts.tolist() == b.histogram.counts.tolist()
        assert a.histogram.values_ns.tolist() == b.histogram.values_ns.tolist()
        assert (a.histogram.overflow, a.histogram.max_ns) == (b.histogram.overflow, b.histogram.max_ns)
        if a.histogram.overflow:
            assert a.histogram.overflow_from_ns == b.histogram.overflow_from_ns == 64_000
        assert "order" in a.left_out[0]


@pytest.mark.root
def test_jitterdebugger_is_read(tmp_path):
    program = shutil.which("jitterdebugger", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install jitterdebugger"
    subprocess.run([program, "-l", "500", "-p", "1", "-o", str(tmp_path)], capture_output=True, check=True, timeout=60)
    imported = read(tmp_path / "results.json")
    raw = json.loads((tmp_path / "results.json").read_text())["cpu"]
    assert [cpu.histogram.n for cpu in imported] == [cpu["count"] for cpu in raw.values()]
    assert [cpu.histogram.max_ns for cpu in imported] == [1000 * cpu["max"] for cpu in raw.values()]


def test_timerlat_is_read_by_context(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    imported = {column.name: column for column in read(file)}
    thread = imported["timerlat-Thr-001"].histogram
    assert (thread.n, thread.overflow, thread.bin_ns, thread.max_ns) == (1002, 2, 10_000, 210_000)
    assert thread.values_ns.tolist() == [0, 10_000, 20_000]
    adopted = adopt(file, tmp_path / "out", platform=Platform.HARDWARE)
    assert [folder.name for folder, _ in adopted] == ["tl-interrupt", "tl-thread", "tl-user"]
    assert [group.n for group in study(tmp_path / "out", THESIS).groups] == [1999, 2001, 1999]


def test_the_largest_value_decides_a_deadline_beyond_the_bins(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    adopt(file, tmp_path / "out", platform=Platform.HARDWARE)
    by_context = {g.parameters["context"]: g for g in study(tmp_path / "out", THESIS).groups}
    assert by_context["thread"].verdict is not None and by_context["thread"].verdict.late == 0
    by_context = {g.parameters["context"]: g for g in study(tmp_path / "out", Question(deadline_ns=100_000)).groups}
    assert by_context["thread"].verdict is None and "beyond" in str(by_context["thread"].undecidable)


def cyclictest_text(folder, text, **known):
    return read_text(folder / "x.txt", text, **known)


@pytest.mark.parametrize("log", sorted(LOGS_2014.glob("*.log")), ids=lambda path: path.name[:30])
def test_logs_of_2014_become_runs(tmp_path, log, capsys):
    assert main(["import", str(log), "--results", str(tmp_path / "out"), *HARDWARE]) == 0
    printed = capsys.readouterr().out
    assert "not known of " in printed and ": the samples" in printed
    (group,) = study(tmp_path / "out", THESIS).groups
    assert group.n + sum(len(digest.header.startup) for digest in group.digests) == int(read_log(log).count.sum())


VENDOR = """# /dev/cpu_dma_latency set to 0us
# Total: 000000006 000000005  \t
# Min Latencies: 00001 00001
# Avg Latencies: 00029 00002
# Max Latencies: 00200 00003
# Histogram Overflows: 00001 00000
# Histogram  \t
000000 000000\t000000  \t
000001 000004\t000002 \t
000002 000002\t000000
000003 000000\t000003
# Histogram Overflow at cycle number:
# Thread 0: 00004
# Thread 1:
"""


def test_cyclictest_is_read_whatever_the_order_of_its_parts(tmp_path):
    file = tmp_path / "vendor.txt"
    file.write_text(VENDOR)
    first, second = (thread.histogram for thread in read(file))
    assert (first.values_ns.tolist(), first.counts.tolist()) == ([1000, 2000], [4, 2])
    assert (first.overflow, first.overflow_from_ns, first.max_ns, first.mean_ns) == (1, 4000, 200_000, 29_000.0)
    assert (second.values_ns.tolist(), second.counts.tolist()) == ([1000, 3000], [2, 3])


def test_the_mean_that_was_printed_is_shown_in_spite_of_an_overflow(tmp_path, capsys):
    file = tmp_path / "vendor.txt"
    file.write_text(VENDOR)
    adopt(file, tmp_path / "out", platform=Platform.HARDWARE)
    assert main(["show", "--json", str(tmp_path / "out" / "vendor")]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert [(row["n"], row["mean_us"], row["max_us"]) for row in results] == [(7, 29.0, 200.0), (5, 2.2, 3.0)]


def test_an_interval_that_the_caller_set_is_known(tmp_path):
    (first, _), (unknown, _) = (
        cyclictest_text(tmp_path, VENDOR, command="cyclictest -mqh4 -i200"), cyclictest_text(tmp_path, VENDOR)
    )  # fmt: skip
    assert first.period_ns == 200_000.0 and not any("interval" in text for text in first.left_out)
    assert unknown.period_ns is None and any("interval" in text for text in unknown.left_out)


def test_histograms_of_different_length_are_reported_together(tmp_path, capsys):
    shorter = VENDOR.replace("00029 00002", "00129 00001").replace("00200 00003", "00900 00001")
    shorter = shorter.replace("000003 000000\t000003\n", "").replace("5  \t", "2  \t")
    for name, text in (("a", VENDOR), ("b", shorter)):
        (tmp_path / f"{name}.txt").write_text(text)
        adopt(tmp_path / f"{name}.txt", tmp_path / "out", platform=Platform.HARDWARE)
    assert main(["report", str(tmp_path / "out")]) == 0
    assert "Share of the values above" in (tmp_path / "out" / "report.html").read_text()


def test_more_bins_than_any_program_has_are_refused(tmp_path, monkeypatch):
    rows = "".join(f"{value} 1\n" for value in range(30))
    (tmp_path / "a.txt").write_text(f"# Histogram\n{rows}# Total: 30\n# Max Latencies: 29\n")
    text = json.dumps({"cpu": {"0": {"count": 30, "max": 29, "histogram": {str(value): 1 for value in range(30)}}}})
    (tmp_path / "b.json").write_text(text)
    (tmp_path / "c.txt").write_text(TIMERLAT)
    monkeypatch.setattr(counts, "MAX_BINS", 10)
    for file in sorted(tmp_path.iterdir()):
        with pytest.raises(UsageError, match=rf"{file.name}: more than 10 bins"):
            read(file)


def test_a_line_with_more_columns_than_memory_holds_is_refused(tmp_path):
    file = tmp_path / "wide.txt"
    file.write_text("# Histogram\n0" + " 1" * 200_000 + "\n")
    with pytest.raises(UsageError, match=r"wide.txt:2: a line of more than 262144 characters"):
        read(file)


def test_pipes_and_devices_are_refused_at_once(tmp_path, capsys):
    pipe = tmp_path / "pipe.log"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        assert main(["import", str(path), "--results", str(tmp_path / "out"), *HARDWARE]) == 2
        assert f"{path}: not a regular file" in capsys.readouterr().err


def test_a_renamed_log_of_a_oneshot_timer_is_read_after_its_import(tmp_path):
    log = tmp_path / "kept.log"
    shutil.copy(LOGS_2014 / "oneshot_timer_tests_l200_tm1000-tnRTRR-measured.log", log)
    adopt(log, tmp_path / "out", platform=Platform.HARDWARE)
    (group,) = study(tmp_path / "out", THESIS).groups
    assert group.n == 200


def test_what_was_emulated_stays_so(tmp_path):
    file = tmp_path / "tl.txt"
    file.write_text(TIMERLAT)
    assert main(["import", str(file), "--results", str(tmp_path / "out"), "--platform", "emulated"]) == 0
    assert study(tmp_path / "out", THESIS).platform is Platform.EMULATED


def import_all(folder, *options):
    files = sorted(str(path) for path in folder.rglob("*.txt"))
    return main(["import", *files, "--results", str(folder / "out"), *HARDWARE, *options])


def test_the_platform_is_never_guessed(tmp_path, capsys):
    assert main(["import", str(tmp_path / "x"), "--results", str(tmp_path / "out")]) == 2
    assert "--platform" in capsys.readouterr().err


def test_files_of_four_boards_are_four_scenarios_and_boots_are_counted(tmp_path, capsys):
    for board in range(4):
        for day in (1, 2, 3):
            (tmp_path / f"board{board}_6.6.{board}_2026-11-0{day}.txt").write_text(VENDOR)
    assert import_all(tmp_path, "--names", "{board}_{kernel}_{start}.txt", "--boot", "b") == 0
    groups = study(tmp_path / "out", THESIS).groups
    assert sorted((group.boards, group.target) for group in groups) == [
        ((f"board{board}",), f"board{board}, 6.6.{board}") for board in range(4)
    ]
    assert {record.start_time for record in groups[0].records} == {f"2026-11-0{day}T00:00:00" for day in (1, 2, 3)}
    assert {group.verdict.boots for group in groups} == {1}


def test_unknown_boards_never_pool_and_pass_no_gate(tmp_path, capsys):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{folder}.txt").write_text(VENDOR.replace("000002 \t", "000001 \t").replace("5  ", "4  "))
    assert import_all(tmp_path) == 0
    analysed = study(tmp_path / "out", replace(THESIS, probability=0.9))
    assert len(analysed.groups) == 2 and not analysed.pooled
    question = ["--deadline", "400us", "--probability", "0.9", "--assume-independent", "--bursts", "1"]
    assert main(["gate", str(tmp_path / "out"), *question]) == 1
    assert capsys.readouterr().out.count("of an unknown board: import it with --board") >= 1
    assert (
        main(["import", str(tmp_path / "a" / "a.txt"), "--results", str(tmp_path / "b2"), *HARDWARE, "--board", "x"])
        == 0
    )
    assert main(["gate", str(tmp_path / "b2"), *question]) == 0


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--names", "{bord}.txt"], "--names: {bord}: a field once each of {board}, {kernel}, {boot}, {start}"),
        (["--names", "{board}-{board}.txt"], "--names: {board}: a field once"),
        (["--names", "{board}.log"], "a.txt: its name is not {board}.log, as --names says"),
        (["--start", "yesterday"], "--start: 'yesterday' is no time"),
    ],
)
def test_what_is_no_identity(tmp_path, capsys, option, message):
    (tmp_path / "a.txt").write_text(VENDOR)
    assert import_all(tmp_path, *option) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_one_bad_file_does_not_stop_the_others(tmp_path, capsys):
    good, bad = tmp_path / "good.txt", tmp_path / "bad.txt"
    good.write_text(TIMERLAT)
    bad.write_text("hello")
    assert main(["import", str(bad), str(good), "--results", str(tmp_path / "out"), *HARDWARE]) == 2
    assert "bad.txt: expected a log" in capsys.readouterr().err
    assert (tmp_path / "out" / "good-thread" / "run.json").exists()
    assert main(["import", str(good), "--results", str(tmp_path / "out"), *HARDWARE]) == 2
    assert "there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cut.txt", "# Histogram\n000001 000002\n", "cut off: no line # Min Latencies"),
        ("empty.txt", "# Histogram\n# Total: 0\n", "cut off: no bins"),
        (
            "sum.txt",
            "# Histogram\n000000 000000\n000001 000002\n# Total: 3\n# Min Latencies: 1\n# Avg Latencies: 1\n"
            "# Max Latencies: 1\n# Histogram Overflows: 0\n# Histogram Overflow at cycle number:\n# Thread 0:\n",
            "sum.txt:4: thread 0: a total of 3",
        ),
        ("fall.txt", "# Histogram\n000005 000002\n000004 1\n# Total: 3\n", "fall.txt:3: 4 does not rise"),
        ("nan.txt", "# Histogram\n000005 nan\n# Total: 3\n", "nan.txt:2: expected a bin"),
        ("x.json", '{"cpu": {"0": {"histogram": {"5": NaN}}}}', "expected a number, got 'NaN'"),
        ("y.json", '{"cpu": {"0": {"histogram": {"5": -1}, "count": 1, "max": 5}}}', "cpu.0.5|cpu.0.histogram.5"),
        ("z.json", '{"cpu": {"0": {"histogram": {"5": 9}, "count": 1, "max": 5}}}', "but the bins hold 9"),
        ("n.json", "[" * 100_000, "expected"),
        ("o.json", "{" + '"a":{' * 50_000, "not JSON|nested"),
        (
            "digits.txt",
            "# Histogram\n000001 000002\n# Total: " + "9" * 5000 + "\n",
            "digits.txt:3: expected a whole number",
        ),
        ("digits2.txt", "# Histogram\n000001 " + "9" * 5000 + "\n# Total: 9\n", "digits2.txt:2: expected a whole"),
        ("nul.json", '{"cmdline": "cyclictest", "thread": {"\\u0000": {}}}', "thread.*expected a number"),
        ("up.json", '{"cmdline": "cyclictest", "thread": {"/../x": {}}}', "thread.*expected a number"),
        ("cpu.json", '{"cpu": {"\\u0000": {}}}', "cpu.*expected a number"),
        ("half.json", '{"cpu": {"\\ud800": {}}}', "half of a character"),
        ("tl.txt", TIMERLAT.replace("count:     1000", "count:     1001"), "IRQ-001: a count of 1001"),
        ("tl2.txt", TIMERLAT[: TIMERLAT.index("over:")], "cut off"),
        *(
            (f"tl-{k}.txt", TIMERLAT.replace(right, wrong), f"tl-{k}.txt:{10 + k}: Thr-001: a {what}")
            for k, (right, wrong, what) in enumerate(
                [
                    ("min:          0         3", "min:          0        12", "smallest value of 12"),
                    ("avg:          1         7", "avg:          1        70", "mean of 70"),
                    ("max:          7       210", "max:          7        20", "largest value of 20"),
                ]
            )
        ),
        *(
            (f"tl-no-{word}.txt", TIMERLAT.replace(f"{word}:", "#", 1), f"cut off: no line {word}:")
            for word in ("over", "count", "min", "avg", "max")
        ),
        ("tl3.txt", TIMERLAT.replace("944       134", "944"), "tl3.txt:5: 5 values for 6 columns"),
    ],
)
def test_broken_files_are_refused_with_their_place(tmp_path, name, text, message):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(UsageError, match=message) as refused:
        read(file)
    assert name in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values_ns": [1, 2, 3]}, "3 values_ns, but 1 counts"),
        ({"values_ns": [10**18 + 1]}, "values_ns.0"),
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


@pytest.mark.parametrize("bins", ["-qxh20", "-q -h20us", "-q --histogr 20", "-qH 20"])
def test_json_whose_values_all_lie_beyond_the_last_bin_is_read(tmp_path, bins):
    thread = {"histogram": {}, "cycles": 50, "min": 70, "max": 148, "avg": 96.38}
    data = {"cmdline:": f"cyclictest {bins} -l50", "num_threads": 1, "resolution_in_ns": 0, "thread": {"0": thread}}
    (tmp_path / "x.json").write_text(json.dumps(data))
    (imported,) = read(tmp_path / "x.json")
    assert (imported.histogram.n, imported.histogram.overflow, imported.histogram.overflow_from_ns) == (50, 50, 20_000)


FILES = LOGS_2014.parent / "importers"


def test_cyclictest_without_totals_and_empty_rows_is_read():
    histograms = [thread.histogram for thread in read(FILES / "cyclictest-2.10-h.txt")]
    assert [(bins.n, bins.overflow, bins.max_ns) for bins in histograms] == [(1500, 1, 740_000), (1500, 1, 737_000)]


def test_the_sum_column_of_histofall_is_no_thread():
    assert [thread.histogram.n for thread in read(FILES / "histofall-2threads-rt-tests-2.x.txt")] == [1200, 1200]


def test_one_bucket_of_rtla_reaches_to_the_largest_value():
    irq, thread = (column.histogram for column in read(FILES / "rtla-timerlat-b50-one-bucket.txt"))
    assert irq.bin_ns == thread.bin_ns == 42_000 and thread.max_ns == 41_000


@pytest.mark.parametrize("name", ["cyclictest-2.10-h.txt", "histofall-2threads-rt-tests-2.x.txt"])
def test_each_line_of_the_summary_is_needed_and_agrees(tmp_path, name):
    lines = (FILES / name).read_text().splitlines(keepends=True)
    summary = [k for k, line in enumerate(lines) if "Latencies" in line or "Overflows" in line or "# Thread" in line]
    for k in summary:
        (tmp_path / "cut.txt").write_text("".join(lines[:k]))
        with pytest.raises(UsageError, match="cut off"):
            read(tmp_path / "cut.txt")
        wrong = lines[k].replace(": 00", ": 90", 1) if ": 0" in lines[k] else lines[k].rstrip() + " 00007\n"
        wrong = lines[k].rstrip() + " 00009\n" if "# Thread" in lines[k] else wrong
        (tmp_path / "wrong.txt").write_text("".join([*lines[:k], wrong, *lines[k + 1 :]]))
        with pytest.raises(UsageError, match=r"wrong\.txt"):
            read(tmp_path / "wrong.txt")


def test_a_text_that_was_cut_before_its_overflows_is_refused():
    with pytest.raises(UsageError, match="cut off: no line # Histogram Overflows"):
        read(FILES / "cyclictest-cut-before-overflows.txt")
