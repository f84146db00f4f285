"""rteval's report, written by hand (tests/rteval_report.py): its histograms are read, and what it states is checked."""

import json

import pytest

from rteval_report import CPUS, page, report
from rtfiles.errors import UsageError
from rtfiles.untrusted import LINE_CHARACTERS_MAX, XML_DEPTH_MAX
from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.plan.question import Question
from rtrun.results.importers.adopt import adopt
from rtrun.results.importers.detect import read
from rtrun.targets.inspection.platform import Platform

LINES = report().splitlines()


def written(tmp_path, text):
    path = tmp_path / "summary.xml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("profile", [False, True])
def test_each_cpu_is_a_histogram(tmp_path, profile):
    imported = read(written(tmp_path, report(profile=profile)))
    assert [cpu.name for cpu in imported] == ["rteval-cpu0", "rteval-cpu3"]
    for cpu, bins in zip(imported, CPUS.values(), strict=True):
        values = [value * 1000 for value in bins]
        assert (cpu.histogram.values_ns.tolist(), cpu.histogram.counts.tolist()) == (values, [*bins.values()])
        assert (cpu.histogram.max_ns, cpu.histogram.bin_ns, cpu.histogram.overflow) == (values[-1], 1000, 0)
        assert cpu.period_ns == 100_000.0 and "the order" in cpu.left_out[0] and not cpu.undecidable


def test_it_becomes_a_run_that_is_judged(tmp_path, capsys):
    adopt(written(tmp_path, report()), tmp_path / "out", platform=Platform.HARDWARE)
    (group,) = study(tmp_path / "out", Question(deadline_ns=10_000)).groups
    assert (group.n, group.verdict.late) == (884, 1)
    assert main(["show", "--json", str(tmp_path / "out" / "summary")]) == 0
    assert [result["n"] for result in json.loads(capsys.readouterr().out)["results"]] == [494, 390]


@pytest.mark.parametrize("version", ["3.2", "2.14", "", "UNIT-TEST"])
def test_no_answer_rests_on_a_version_that_hides_an_overflow(tmp_path, version):
    adopt(written(tmp_path, report(version=version)), tmp_path / "out", platform=Platform.HARDWARE)
    (group,) = study(tmp_path / "out", Question(deadline_ns=1_000_000)).groups
    assert group.verdict is None and "leaves out values beyond the last bucket" in group.undecidable
    adopt(written(tmp_path, report(version="3.3")), tmp_path / "safe", platform=Platform.HARDWARE)
    assert study(tmp_path / "safe", Question(deadline_ns=1_000_000)).groups[0].verdict is not None


def test_a_run_that_a_value_ended_says_so(tmp_path):
    first, _ = read(written(tmp_path, report(stopped_above_us=10)))
    assert "what followed the value above 10 us at which rteval ended it" in first.left_out


@pytest.mark.parametrize("bins", [{"0": {}, "1": {4: 1}}, {"0": {4: 1}, "1": {4: 1}}])
def test_a_cpu_of_no_value_or_of_one(tmp_path, bins):
    assert [cpu.histogram.n for cpu in read(written(tmp_path, report(bins)))] == [
        sum(b.values()) for b in bins.values()
    ]


def test_more_beyond_the_buckets_than_is_stated_is_refused(tmp_path):
    with pytest.raises(
        UsageError, match=r"xml:\d+: maximum: a value of 12 us, but the histogram ends below 12: how many"
    ):
        read(written(tmp_path, report(buckets=12, maximum=12)))
    overflowed = page(['<cyclictest command_line="cyclictest -i100 -qmu -h 12 -p95 -t2 -a0,3"/>'])
    with pytest.raises(UsageError, match=r"leaves them out where a value was beyond .*--cyclictest-buckets"):
        read(written(tmp_path, overflowed))


@pytest.mark.parametrize("name", [line for line in LINES if "unit=" in line or "<samples" in line or "<bucket" in line])
def test_what_is_missing_or_stands_twice_is_refused(tmp_path, name):
    text = "\n".join(LINES)
    with pytest.raises(UsageError, match=r"xml:\d+: .*twice"):
        read(written(tmp_path, text.replace(name, f"{name}\n{name}", 1)))
    if "median" not in name:
        with pytest.raises(UsageError, match=r"xml:\d+: (\w+ is missing|system \S+ .* is missing|.*but )|is missing"):
            read(written(tmp_path, text.replace(name, "", 1)))


@pytest.mark.parametrize(
    "name", ["mode", "range", "mean_absolute_deviation", "standard_deviation", "mean", "minimum", "maximum"]
)
def test_what_was_computed_of_the_buckets_agrees_with_them(tmp_path, name):
    for place in range(3):
        at = [k for k, line in enumerate(LINES) if f"<{name} " in line][place]
        number = LINES[at].partition(">")[2].partition("<")[0]
        lines = [*LINES[:at], LINES[at].replace(f">{number}", f">{float(number) + 1:g}"), *LINES[at + 1 :]]
        with pytest.raises(UsageError, match=rf"xml:{at + 1}: {name}: "):
            read(written(tmp_path, "\n".join(lines)))


TIMERLAT = ['<timerlat command_line="rtla timerlat hist -p100 -P f:95 -u -c0-3 -E3500 --no-summary"/>']


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (report().replace('unit="us"', 'unit="ns"', 1), r":\d+: minimum: expected the unit us, got 'ns'"),
        (report().replace("<samples>494", "<samples>495"), r":\d+: samples: 495, but the buckets hold 494"),
        (report().replace("<samples>494", "<samples>-4"), r":\d+: samples: expected a whole number"),
        (report().replace('<core id="3"', '<core id="0"'), r":\d+: 0 stands twice"),
        (report().replace('<core id="3"', '<core id="/../x"'), r":\d+: id: expected a whole number"),
        (report().replace('<core id="3"', '<core id="8192"'), r":\d+: core: id 8192, expected less than 8192"),
        (report({"0": CPUS["0"]}).replace('index="11" value="1"', 'index="11" value="2"', 1), "494, but .* hold 495"),
        (
            report(stopped_above_us=10).replace('threshold="10"', 'threshold="&#8238;"'),
            r":\d+: latency_threshold: expected",
        ),
        (page(TIMERLAT), "no values of cyclictest. rteval's values of timerlat are not read: it adds up"),
        (page([]), "no values of cyclictest"),
        (report().replace("</Measurements>", "<cyclictest/></Measurements>"), r":\d+: a second measurement"),
        (report()[:-20], r":\d+: not XML: "),
        (report().replace("<rteval", '<!DOCTYPE x [<!ENTITY a "b">]>\n<rteval'), ":2: a document type"),
        (report().replace("10:00:00", "&a;"), r":\d+: not XML: undefined entity"),
        (f"<rteval >{'<a>' * XML_DEPTH_MAX}", f":1: nested more than {XML_DEPTH_MAX} deep"),
        (f"<rteval >{' ' * LINE_CHARACTERS_MAX}", f"more than {LINE_CHARACTERS_MAX} characters without a <"),
    ],
)
def test_what_is_no_report_is_refused_with_its_place(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=message) as refused:
        read(path)
    assert str(refused.value).startswith(f"{path}:")


def test_a_system_that_is_not_the_sum_of_its_cpus_is_refused(tmp_path):
    whole, half = report().splitlines(), report({"0": CPUS["0"]}).splitlines()
    begin, end = ("  " * 3 + word for word in ("<system", "</system>"))
    at = [next(k for k, line in enumerate(lines) if line.startswith(word)) for lines, word in (
        (whole, begin), (whole, end), (half, begin), (half, end),
    )]  # fmt: skip
    text = "\n".join([*whole[: at[0]], *half[at[2] : at[3]], *whole[at[1] :]])
    with pytest.raises(UsageError, match=r"xml:\d+: system: 0 values of 1 us, but the CPUs have 2"):
        read(written(tmp_path, text))
