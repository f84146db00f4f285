"""What cyclictest and hwlatdetect print, taken at its word only as far as it adds up."""

import re
from pathlib import Path

import pytest

from rtrun.plan.campaign import Campaign, plan
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.validity.baselines import HardwareGaps, check_baseline_output, keep_histograms, read_gaps

DATA = Path(__file__).parents[2] / "data"

# As rt-tests 2.9 and later print it: no totals, and no rows of zeros.
PRINTED = """# /dev/cpu_dma_latency set to 0us
# Histogram
000014 000001\t000000
000015 000008\t000010
# Min Latencies: 00014 00015
# Avg Latencies: 01019 00015
# Max Latencies: 10062 00015
# Histogram Overflows: 00001 00000
# Histogram Overflow at cycle number:
# Thread 0: 00003
# Thread 1:
"""
# The same without the value above the histogram.
LAGGED = (
    PRINTED.replace("Overflows: 00001", "Overflows: 00000")
    .replace("Thread 0: 00003", "Thread 0:")
    .replace("01019 00015", "00014 00015")
    .replace("10062", "00015")
)
# What a thread prints that was not woken once.
ASLEEP = (
    LAGGED.replace("000001\t", "000000\t")
    .replace("000008\t", "000000\t")
    .replace("Latencies: 00014 ", "Latencies: 1000000 ", 1)
)
ASLEEP = ASLEEP.replace("Avg Latencies: 00014", "Avg Latencies: 00000").replace(
    "Max Latencies: 00015", "Max Latencies: 00000"
)


NONE = "000000\t000000"


def older(printed, *, totals="000000009 000000010", rows=10_000):
    """The same as rt-tests up to 2.4 print it: with totals, and every row."""
    filled = dict(re.findall(r"^(\d{6}) (.*)$", printed, flags=re.MULTILINE))
    numbers = [f"{row:06}" for row in range(rows)]
    every = "".join(f"{number} {filled.get(number, NONE)}\n" for number in numbers)
    start, end = printed.index("000014"), printed.index("# Min")
    return f"{printed[:start]}{every}# Total: {totals}\n{printed[end:]}"


def run_of(suite, **values):
    return plan(Campaign(schema=1, name="test", runs=[{"suite": suite, **values}]), "test")[0]


@pytest.mark.parametrize("printed", [PRINTED, older(PRINTED)], ids=["2.10", "2.4"])
def test_every_thread_measured_as_often_as_asked(printed):
    assert check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), printed) is None


@pytest.mark.parametrize(
    ("asked", "printed", "reason"),
    [
        (0, PRINTED.partition("\n")[2], "asked to hold /dev/cpu_dma_latency at 0 us, it held it at nothing"),
        (None, PRINTED, "asked to hold /dev/cpu_dma_latency at nothing, it held it at 0 us"),
        (None, PRINTED.partition("\n")[2], None),
    ],
)
def test_idle_cpus_were_kept_awake_as_asked(asked, printed, reason):
    run = run_of("cyclictest", repetitions=10, threads=2, cpu_dma_latency_us=asked)
    reported = check_baseline_output(run, printed)
    assert reported == reason if reason is None else reported.startswith(reason)


def test_a_thread_that_lagged_when_the_first_was_done_has_measured_less():
    assert check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), LAGGED) is None


@pytest.mark.parametrize(
    ("printed", "message"),
    [
        ("", "cyclictest.stdout:0: cut off: no bins"),
        (PRINTED.partition("# Min")[0], "cut off: no line # Min Latencies"),
        (
            LAGGED.replace("10", "09"),
            r"asked for 10 measurements each, they made \[9, 9\]",
        ),
        (ASLEEP, r"asked for 10 measurements each, they made \[0, 10\]"),
        (older(PRINTED.replace("000008\t", "000007\t")), "thread 0: a total of 9, but the bins hold 8"),
        (older(PRINTED, totals="000000009"), "the number of threads differs: 2 columns of bins, .*1 in Total"),
        (
            re.sub(r"(?<!:)[\t ]\d+$", "", PRINTED, flags=re.MULTILINE).replace("# Thread 1:\n", ""),
            r"2 threads were asked .* made \[10\]",
        ),
        # The command line tells where the histogram ends.
        (
            PRINTED.replace("10062", "09999"),
            "stdout:7: thread 0: a largest value of 9999, but 1 values are 10000 and more",
        ),
        (
            PRINTED.replace("000015 000008", "010000 000008"),
            "stdout:4: a bin of 10000, but the histogram ends below 10000",
        ),
        (older(PRINTED, rows=9999), "cut off: 9999 rows of bins, the command line asks for 10000"),
    ],
)
def test_what_does_not_add_up(printed, message):
    problem = check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), printed)
    assert problem is not None
    assert re.search(message, problem)


def test_a_character_that_is_none_is_of_no_matter(tmp_path):
    run = run_of("cyclictest", repetitions=10, threads=2)
    (tmp_path / "cyclictest.stdout").write_bytes(b"# \xff\n" + PRINTED.encode())
    outputs = keep_histograms(tmp_path, run, "cyclictest")
    kept = [read_histogram(tmp_path / f"{output}{ENDING}") for output in outputs]
    assert [(imported.histogram.n, imported.period_ns) for imported in kept] == [(10, 1e6), (10, 1e6)]
    assert kept[0].histogram.overflow_from_ns == 10_000_000


def test_hwlatdetect_must_have_a_result():
    result = (DATA / "unreadable/hwlatdetect.txt").read_text()
    none = "Max Latency: Below threshold\nSamples recorded: 0\n"
    for text, gaps in ((result, HardwareGaps(found=1, longest_us=14)), (none, HardwareGaps(found=0, longest_us=0))):
        assert check_baseline_output(run_of("hwlatdetect"), text) is None
        assert read_gaps(text) == gaps
    for text in (result.partition("Max")[0], result.partition("Samples")[0], result.replace("14us", "9" * 40 + "us")):
        assert check_baseline_output(run_of("hwlatdetect"), text) is not None
