"""What a file of another program states twice must agree: each number of a valid file is changed, alone."""

import json
import re
from pathlib import Path

import pytest

from rteval_report import report
from rtfiles.errors import UsageError
from rtrun.results.importers.counts import StatedSummary, Statistics, check_statistics
from rtrun.results.importers.cyclictest import read_text
from rtrun.results.importers.detect import read

FILES = Path(__file__).parents[3] / "data" / "importers"
CYCLICTEST_2_4_ROWS = 500
TIMERLAT = """# RTLA timerlat histogram
# Time unit is microseconds (us)
# Duration:   0 00:00:02
Index   IRQ-001   Thr-001   Usr-001
0          1000       944       134
10            0        55       863
20            0         1         3
over:         0         2         0
count:     1000      1002      1000
min:          0         3         4
avg:          1         7        10
max:          7       210        24
ALL:        IRQ       Thr       Usr
count:     1000      1002      1000
min:          0         3         4
avg:          1         7        10
max:          7       210        24
"""
TWO_CPUS = """# RTLA timerlat histogram
# Time unit is nanoseconds (ns)
# Duration:   0 00:00:02
Index   IRQ-000   Thr-000   IRQ-001   Thr-001
0             2         0         4         0
1000          2         4         0         0
over:         0         0         0         0
count:        4         4         4         0
min:        500      1200         3         -
avg:        900      1500       100         -
max:       1100      1900       300         -
ALL:        IRQ       Thr
count:        8         4
min:          3      1200
avg:        500      1500
max:       1100      1900
"""
JITTERDEBUGGER = {
    "version": 3,
    "sysinfo": {"nodename": "vm", "release": "6.18.44", "cpus_online": 2, "resolution_in_ns": 1000},
    "cpu": {
        "0": {"histogram": {"34": 1, "52": 124, "53": 167, "62": 1}, "count": 293, "min": 34, "max": 62, "avg": 52.54},
        "1": {"histogram": {"15": 23, "16": 212}, "count": 236, "min": 15, "max": 2345, "avg": 25.77},
    },
}


def histofall():
    """Rows of zeros cut off above the largest value, as a shorter -H has it."""
    lines = (FILES / "histofall-2threads-rt-tests-2.x.txt").read_text().splitlines(keepends=True)
    return "".join(line for line in lines if not re.match("00[0-9]{4} ", line) or int(line[:6]) < CYCLICTEST_2_4_ROWS)


CYCLICTEST = json.loads((FILES / "cyclictest-json-fifo-200us.json").read_text())
VALID = {
    "cyclictest-2.4.txt": histofall(),
    "cyclictest-2.10.txt": (FILES / "cyclictest-2.10-h.txt").read_text(),
    "cyclictest.json": json.dumps(CYCLICTEST, indent=1),
    "jitterdebugger.json": json.dumps(JITTERDEBUGGER, indent=1),
    "timerlat.txt": TIMERLAT,
    "rteval.xml": report(),
}
LINES_OR_KEYS = [name for name in VALID if not name.endswith(".xml")]  # of elements see test_rteval.py
# Lines whose numbers the file states nowhere else.
ONCE = {
    "cyclictest-2.10.txt": "[0-9]{6} |# Max Latencies",  # it prints no totals; its largest values lie above the bins
    "cyclictest.json": ' "cmdline:"|   "max": 559|   "cpu"',
    "jitterdebugger.json": '   "max": 2345',
    "timerlat.txt": "Index",  # the number of the CPU
    "rteval.xml": " +<(core|cyclictest)",  # the number of the CPU, the command line
}


# Rows without a value, which differ in nothing but their number: one of forty is changed.
EMPTY = r"[0-9]{6} (000000\t?)+"


def meaning(imported):
    return [
        (
            entry.name,
            entry.histogram.values_ns.tolist(),
            entry.histogram.counts.tolist(),
            (entry.histogram.bin_ns, entry.histogram.overflow, entry.histogram.overflow_from_ns),
            (entry.histogram.max_ns, entry.histogram.mean_ns, entry.period_ns),
            entry.parameters,
        )
        for entry in imported
    ]


def written(path, text):
    path.write_text(text)
    return path


def changed(number, is_bin):
    """Other numbers in its place. A bin is moved far: means are printed with few digits."""
    point = number.partition(".")[2]
    for step in (50, -50) if is_bin else (1, -1, 50):
        if (value := float(number) + step) >= 0:
            yield f"{value:.{len(point)}f}".rjust(len(number), " " if number[:1] != "0" else "0")


@pytest.mark.parametrize("name", VALID)
def test_a_number_that_is_changed_alone_is_refused_or_does_not_matter(tmp_path, name):
    text, path = VALID[name], tmp_path / name
    right = meaning(read(written(path, text)))
    accepted, refused = set(), 0
    for match in re.finditer(r"(?<![\w.])[0-9]+(\.[0-9]+)?(?![\w.])", text):
        start = text.rfind("\n", 0, match.start()) + 1
        line = text[start : text.index("\n", start)]
        if name in ONCE and re.match(ONCE[name], line):
            continue
        if re.fullmatch(EMPTY, line) and int(line.split()[0]) % 40:
            continue
        is_bin = bool(re.match(r' +"[0-9]+": [0-9]', line)) and text[match.end()] == '"'
        for other in changed(match[0], is_bin):
            written(path, text[: match.start()] + other + text[match.end() :])
            try:
                if meaning(read(path)) != right:
                    accepted.add(f"{match[0]} -> {other} in {line}")
            except UsageError as error:
                assert str(error).startswith(f"{path}:"), error
                refused += 1
    assert not accepted and refused > 20


@pytest.mark.parametrize("name", LINES_OR_KEYS)
def test_a_line_or_key_that_stands_twice_is_refused(tmp_path, name):
    lines = VALID[name].splitlines(keepends=True)
    for k, line in enumerate(lines):
        if name.endswith(".txt") and not re.match(
            "# (Hist|Min|Max|Avg|Thread|Total|RTLA|Time|Dur)|Index|[a-zA-Z]+:", line
        ):
            continue
        if name.endswith(".json") and not re.match(r' *"[^"]*": [^{]*$', line):
            continue
        twice = [
            *lines[:k],
            line.replace("\n", ",\n") if name.endswith(".json") and "," not in line else line,
            *lines[k:],
        ]
        expected = rf":{k + 2}: a second line .*, the first one is line {k + 1}$|the key .* stands twice"
        if re.match("(count|min|avg|max):", line) and name == "timerlat.txt":
            expected = f":{k + 2}: a second line {line.split()[0]}.*, the first one is line {k + 1}$"
        with pytest.raises(UsageError, match=expected):
            read(written(tmp_path / name, "".join(twice)))


@pytest.mark.parametrize("name", LINES_OR_KEYS)
def test_a_line_or_key_that_is_missing_is_refused_by_its_name(tmp_path, name):
    text = VALID[name]
    if name.endswith(".json"):
        parts = re.findall(
            r'^ *"(cycles|count|min|max|avg|histogram|num_threads|resolution_in_ns|cpus_online)"', text, re.M
        )
        for part in set(parts):
            with pytest.raises(UsageError, match=rf"{name}: \S*{part}: "):
                read(written(tmp_path / name, text.replace(f'"{part}"', '"x"', 1)))
        return
    for line in text.splitlines(keepends=True):
        # Without its totals a text of 2.4 is one of 2.10.
        if re.match("# (Min L|Max L|Avg L|Thread|Histogram|Time|Dur)|Index|[a-z]+:", line):
            with pytest.raises(UsageError, match=r"cut off: no |threads differs|threads$"):
                read(written(tmp_path / name, text.replace(line, "", 1)))


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("count:        8", "count:        9", r"tl\.txt:13: IRQ: count: 9 of all, but the columns give 8"),
        ("min:          3", "min:          2", r"tl\.txt:14: IRQ: min: 2 of all, but the columns give 3"),
        ("min:          3", "min:          -", r"tl\.txt:14: IRQ: min: None of all, but the columns give 3"),
        ("avg:        500", "avg:        501", r"tl\.txt:15: IRQ: avg: 501 of all, but the columns give 500"),
        ("avg:        500", "avg:        499", r"tl\.txt:15: IRQ: avg: 499 of all"),
        ("max:       1100      1900\n", "max:       1101      1900\n", r"tl\.txt:16: IRQ: max: 1101 of all"),
        ("IRQ       Thr\n", "Thr       IRQ\n", r"tl\.txt:12: ALL: expected columns IRQ Thr, as Index has them"),
        ("Thr-001", "Thr-000", r"tl\.txt:4: a column stands twice"),
        ("max:       1100      1900\n", "", r"cut off: no line max: below ALL:"),
        ("nanoseconds (ns)", "nanoseconds (us)", r"tl\.txt:2: expected one of # Time unit is nanoseconds \(ns\), "),
        ("avg:        900", "avg:          -", r"tl\.txt:10: IRQ-000: avg: expected a whole number"),
    ],
)
def test_the_summary_of_all_cpus_is_that_of_the_columns(tmp_path, right, wrong, message):
    assert [column.histogram.n for column in read(written(tmp_path / "tl.txt", TWO_CPUS))] == [4, 4, 4, 0]
    at = TWO_CPUS.rindex(right)
    with pytest.raises(UsageError, match=message):
        read(written(tmp_path / "tl.txt", TWO_CPUS[:at] + wrong + TWO_CPUS[at + len(right) :]))


def test_a_thread_that_measured_nothing_is_named(tmp_path):
    # What C prints of zero divided by zero.
    text = VALID["cyclictest.json"].replace("63.3", "-nan")
    with pytest.raises(UsageError, match=r'x\.json:[0-9]+: "avg": -nan: thread or CPU 1 made no measurement, expected'):
        read(written(tmp_path / "x.json", text))


def edited(change, data=CYCLICTEST):
    data = json.loads(json.dumps(data))
    change(data)
    return json.dumps(data)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.update(num_threads=3), "num_threads: 3, but thread has 2"),
        (lambda data: data["thread"].update({"2": data["thread"].pop("1")}), r"thread\.1: missing, .* 2 from 0 on"),
        (lambda data: data.update(resolution_in_ns=1), r"resolution_in_ns: 1, but its command line asks for microsec"),
        (
            lambda data: data.update({"cmdline:": "cyclictest -qNm -h400"}),
            "resolution_in_ns: 0, .* asks for nanoseconds",
        ),
        (lambda data: data["thread"]["0"]["histogram"].update({"400": 0}), r"thread\.0\.histogram\.400: a bin of 400"),
        (lambda data: data["thread"]["0"]["histogram"].update({"024": 0}), r"thread\.0\.histogram: '024' is no bin"),
        (lambda data: data["thread"]["0"].pop("histogram"), r"thread\.0\.histogram: missing, run .* --histogram=US"),
        (lambda data: data["thread"]["0"].update(min=23), r"thread\.0\.min: a smallest value of 23, .* bin is 24"),
        (lambda data: data["thread"]["0"].update(max=124), r"thread\.0\.max: a largest value of 124, .* bin is 123"),
        (lambda data: data["thread"]["1"].update(max=399), r"thread\.1\.max: a largest value of 399, .* 400 and more"),
        (lambda data: data["thread"]["0"].update(avg=61.07), r"thread\.0\.avg: a mean of 61\.07, .* 61\.05 to 61\.05"),
        (lambda data: data["thread"]["0"].update(cycles=1499), r"thread\.0\.cycles: 1499, but the bins hold 1500"),
        (
            lambda data: data["thread"]["0"].update(cycles=0, histogram={}, avg=0.0),
            r"thread\.0\.max: 123, but nothing was measured",
        ),
    ],
)
def test_json_of_cyclictest_that_contradicts_itself(tmp_path, change, message):
    with pytest.raises(UsageError, match=rf"x\.json: {message}"):
        read(written(tmp_path / "x.json", edited(change)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data["sysinfo"].update(cpus_online=1), r"sysinfo\.cpus_online: 1, but cpu has 2"),
        (lambda data: data["sysinfo"].update(resolution_in_ns=[1]), r"sysinfo\.resolution_in_ns: expected a whole"),
        (lambda data: data.pop("sysinfo"), r"sysinfo\.resolution_in_ns: expected a whole number"),
        (lambda data: data["cpu"]["1"].update(max=999), r"cpu\.1\.max: a largest value of 999, .* 1000 and more"),
        (
            lambda data: data["cpu"]["1"]["histogram"].update({"1000": 1}),
            r"cpu\.1\.histogram\.1000: a bin of 1000, but",
        ),
    ],
)
def test_results_of_jitterdebugger_that_contradict_themselves(tmp_path, change, message):
    with pytest.raises(UsageError, match=rf"x\.json: {message}"):
        read(written(tmp_path / "x.json", edited(change, JITTERDEBUGGER)))


def test_nanoseconds_of_jitterdebugger_end_at_a_millisecond(tmp_path):
    cpu = {"histogram": {"4000": 1}, "count": 2, "min": 4000, "max": 1_200_000, "avg": 602_000.0}
    data = JITTERDEBUGGER | {"cpu": {"0": cpu}, "sysinfo": {"cpus_online": 2, "resolution_in_ns": 1}}
    (read_back,) = read(written(tmp_path / "x.json", json.dumps(data)))
    assert (read_back.histogram.overflow, read_back.histogram.overflow_from_ns) == (1, 1_000_000)


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("cyclictest -q -h 400 -t2", (400_000, 1000, 1e6)),
        ("cyclictest -qmh400 -Sp99 -i200", (400_000, 1000, 200_000.0)),
        ("cyclictest --histofall=300 -h 400 --interval 500", (400_000, 1000, 500_000.0)),
        ("cyclictest -mNqh 400", (400, 1, 1e6)),
        ("cyclictest -qxh400 -xi200", (400_000, 1000, 200_000.0)),
        ("cyclictest -h400us -p80 -i500us", (400_000, 1000, 500_000.0)),
        ("cyclictest --histogr 400 --int=300 --nse", (400, 1, 300_000.0)),
        ("cyclictest -h 500 --histof=400 -p9", (400_000, 1000, 1e6)),
        ("cyclictest --histogram=2000000", None),
        ("cyclictest --histogram=232", None),
    ],
)
def test_the_command_line_tells_where_the_bins_end(command, expected):
    text = VALID["cyclictest-2.10.txt"]
    if expected is None:
        with pytest.raises(UsageError, match=r"the histogram ends below 232|values are 1000000 and more"):
            read_text(Path("x.txt"), text, command=command)
        return
    (first, _) = read_text(Path("x.txt"), text, command=command)
    assert (first.histogram.overflow_from_ns, first.histogram.bin_ns, first.period_ns) == expected


def test_the_sum_of_one_thread_is_no_thread():
    # rt-tests 2.9 and later, -H of one thread: only the rows have it.
    rows = (
        "# Histogram\n000003 000002\t00000{}\n# Min Latencies: 00003\n# Avg Latencies: 00003\n# Max Latencies: 00003\n"
    )
    rows += "# Histogram Overflows: 00000\n# Histogram Overflow at cycle number:\n# Thread 0: \n"
    (thread,) = read_text(Path("x.txt"), rows.format(2))
    assert thread.histogram.n == 2
    with pytest.raises(UsageError, match=r"x\.txt:1: the last column is not the sum"):
        read_text(Path("x.txt"), rows.format(3))


def test_rows_of_a_text_with_totals_are_all_there(tmp_path):
    text = VALID["cyclictest-2.4.txt"].replace("000100 000000\t000000\t000000\n", "")
    assert text != VALID["cyclictest-2.4.txt"]
    with pytest.raises(UsageError, match=r"x\.txt:103: a row is missing before this one"):
        read(written(tmp_path / "x.txt", text))


@pytest.mark.parametrize(
    ("bins", "overflow", "least", "mean", "most", "wrong"),
    [
        ({3: 2, 5: 2}, 0, 3, 4, 5, None),
        ({3: 2, 5: 2}, 0, 3, 3, 5, "mean"),  # truncated, but 16 / 4 is whole
        ({3: 1, 5: 2}, 0, 3, 4, 5, None),
        ({3: 1}, 1, 3, 6, 10, None),
        ({3: 1}, 1, 3, 7, 10, "mean"),
        ({}, 2, 20, 24, 29, None),
        ({}, 2, 20, 25, 29, "mean"),
        ({}, 2, 30, 30, 29, "least"),
        ({}, 2, 9, 20, 29, "least"),
        ({}, 0, 10**6, 0, 0, None),
        ({}, 0, 10**6, 1, 0, "mean"),
        ({}, 0, None, None, None, None),
        ({3: 1}, 2, None, 40, None, None),
    ],
)
def test_bounds_of_what_was_printed(bins, overflow, least, mean, most, wrong):
    printed = Statistics(
        least=StatedSummary(place="least", value=least),
        mean=StatedSummary(place="mean", value=mean),
        most=StatedSummary(place="most", value=most),
    )
    if wrong is None:
        check_statistics(bins, printed, overflow=overflow, limit=10)
        return
    with pytest.raises(UsageError, match=f"^{wrong}: "):
        check_statistics(bins, printed, overflow=overflow, limit=10)
