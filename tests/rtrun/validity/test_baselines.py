"""What cyclictest and hwlatdetect print, taken at its word only as far as it adds up."""

import re

import pytest

from rtrun.plan.campaign import Campaign, plan
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.validity.baselines import check_baseline_output, keep_histograms

PRINTED = """# /dev/cpu_dma_latency set to 0us
# Histogram
000014 000001\t000000
000015 000008\t000010
# Total: 000000009 000000010
# Min Latencies: 00014 00015
# Avg Latencies: 00019 00015
# Max Latencies: 00062 00015
# Histogram Overflows: 00001 00000
# Histogram Overflow at cycle number:
# Thread 0: 00003
# Thread 1:
"""
# The same without the value above the histogram.
LAGGED = (
    PRINTED.replace("Overflows: 00001", "Overflows: 00000")
    .replace("Thread 0: 00003", "Thread 0:")
    .replace("00019 00015", "00014 00015")
    .replace("00062", "00015")
)


def run_of(suite, **values):
    return plan(Campaign(schema=1, name="test", runs=[{"suite": suite, **values}]), "test")[0]


def test_every_thread_measured_as_often_as_asked():
    assert check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), PRINTED) is None


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
    said = check_baseline_output(run, printed)
    assert said == reason if reason is None else said.startswith(reason)


def test_a_thread_that_lagged_when_the_first_was_done_has_measured_less():
    assert check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), LAGGED) is None


@pytest.mark.parametrize(
    ("printed", "message"),
    [
        ("", "cyclictest.stdout:0: cut off: no bins"),
        (PRINTED.partition("# Total")[0], "cut off: no line # Min Latencies"),
        (
            LAGGED.replace("10", "09"),
            r"asked for 10 measurements each, they made \[9, 9\]",
        ),
        (
            re.sub("00000[18]\t", "000000\t", LAGGED).replace("09", "00"),
            r"asked for 10 measurements each, they made \[0, 10\]",
        ),
        (PRINTED.replace("000008\t", "000007\t"), "thread 0: a total of 9, but the bins hold 8"),
        (PRINTED.replace(" 000000010", ""), "the number of threads differs: 2 columns of bins, 1 in Total"),
        (
            re.sub(r"(?<!:)[\t ]\d+$", "", PRINTED, flags=re.MULTILINE).replace("# Thread 1:\n", ""),
            r"2 threads were asked .* made \[10\]",
        ),
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
    assert [read_histogram(tmp_path / f"{output}{ENDING}").histogram.n for output in outputs] == [10, 10]


def test_a_cyclictest_that_prints_no_totals_is_as_good():
    printed = re.sub("# Total.*\n", "", PRINTED)
    assert check_baseline_output(run_of("cyclictest", repetitions=10, threads=2), printed) is None


def test_hwlatdetect_must_have_a_result():
    assert check_baseline_output(run_of("hwlatdetect"), "Max Latency: Below threshold\n") is None
    assert check_baseline_output(run_of("hwlatdetect"), "hwlatdetect:  test duration 3 seconds\n") is not None
