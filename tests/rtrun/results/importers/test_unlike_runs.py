"""Runs that were asked for otherwise, or on another host or kernel, are never pooled; a failed one is none."""

import json
from pathlib import Path

import pytest

from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.results.record import RunStatus, read_record

FILES = Path(__file__).parents[3] / "data" / "importers"
FIFO, OTHER = (FILES / f"cyclictest-json-{name}.json" for name in ("fifo-200us", "other-1000us"))
TEXT = (FILES / "cyclictest-2.10-h.txt").read_text()
CPU = {"histogram": {"34": 1, "52": 124}, "count": 125, "min": 34, "max": 52, "avg": 51.86}
JITTERDEBUGGER = {
    "version": 3,
    "sysinfo": {
        "nodename": "board", "release": "6.1.0", "version": "#1 SMP PREEMPT_RT", "cpus_online": 2,
        "resolution_in_ns": 1000,
    },
    "cpu": {"0": CPU},
}  # fmt: skip


@pytest.fixture
def bring(tmp_path):
    """Import files of these names and contents, with these options; returns the status."""

    def bring_in(files, *options):
        for name, content in files.items():
            path = tmp_path / "in" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content if isinstance(content, str) else json.dumps(content))
        paths = [str(tmp_path / "in" / name) for name in files]
        return main(["import", *paths, "--results", str(tmp_path / "out"), "--platform", "hardware", *options])

    return bring_in


def changed(file=FIFO, *, system=None, words=None, cpus=None, **keys):
    """A JSON of cyclictest in which some values are others."""
    data = json.loads(file.read_text()) | keys
    data["sysinfo"] |= system or {}
    if words is not None:
        data["cmdline:"] = f"cyclictest --policy=fifo --priority=99 --interval=200 --histogram=400 --threads=2 {words}"
    for thread, cpu in zip(data["thread"].values(), cpus or (), strict=False):
        thread["cpu"] = cpu
    return data


def moved(data, number):
    """Move some values to another bin: two measurements never make the same counts."""
    for thread in data["thread"].values():
        bins = thread["histogram"]
        first, second = sorted(bins, key=lambda value: bins[value])[-2:]
        bins[first] -= number
        bins[second] += number
        moved_by = number * (int(second) - int(first)) / thread["cycles"]
        thread["avg"] = round(thread["avg"] + moved_by, 2)


def groups(tmp_path):
    return study(tmp_path / "out").groups


def test_fifo_at_200_us_and_other_at_1_ms_are_two_rows(tmp_path, bring, capsys):
    assert bring({"fifo.json": FIFO.read_text(), "other.json": OTHER.read_text()}, "--board", "b") == 0
    by_policy = {group.parameters["policy"]: group for group in groups(tmp_path)}
    assert {policy: group.parameters["interval_us"] for policy, group in by_policy.items()} == {"FIFO": 200, "0": 1000}
    assert by_policy["FIFO"].parameters["priority"] == 99
    assert [len(group.runs) for group in by_policy.values()] == [1, 1]
    capsys.readouterr()
    main(["verdict", str(tmp_path / "out"), "--json"])
    rows = json.loads(capsys.readouterr().out)["groups"]
    assert len(rows) == 2
    assert main(["report", str(tmp_path / "out"), "--format", "markdown", "--output", "-"]) == 0
    page = capsys.readouterr().out
    assert "2 scenarios" in page and "cyclictest FIFO interval" in page and "cyclictest OTHER threads=2" in page


def test_two_runs_alike_are_one_group(tmp_path, bring):
    alike = changed(words="-q -D 10m --json=elsewhere.json")
    third = changed(words="-i 200 -p99")
    for number, text in enumerate((alike, third), start=1):
        moved(text, number)
    assert bring({"a.json": FIFO.read_text(), "b.json": alike, "c.json": third}) == 0
    (group,) = groups(tmp_path)
    assert group.runs == ("a", "b", "c")


@pytest.mark.parametrize(
    "other",
    [
        changed(words="-i 300"),
        changed(words="-p 98"),
        changed(words="--policy=rr"),
        changed(words="-m"),
        changed(words="-c 1"),
        changed(words="--laptop"),
        changed(words="--an-option-of-tomorrow"),
        changed(cpus=[0, 1]),
        changed(system={"nodename": "vm2"}),
        changed(system={"release": "6.18.45"}),
        changed(system={"version": "#2 SMP PREEMPT_RT"}),
    ],
    ids=["interval", "priority", "policy", "memory", "clock", "idle", "unknown", "cpus", "host", "kernel", "build"],
)
def test_runs_that_differ_in_one_thing_are_two_groups(tmp_path, bring, other):
    assert bring({"a.json": FIFO.read_text(), "b.json": other}) == 0
    assert len(groups(tmp_path)) == 2


def test_what_is_unknown_is_never_pooled_with_what_is_known(tmp_path, bring, capsys):
    known = changed(words="--policy=other -i 1000", start_time="Thu, 26 Nov 2026 11:18:02 +0000")
    del known["sysinfo"]
    assert bring({"text.txt": TEXT, "same.txt": TEXT, "a.json": known}, "--board", "b") == 0
    assert (
        "policy, priority, CPUs and other options: runs that do not tell them are taken as alike"
        in capsys.readouterr().out
    )
    assert bring({"text200.txt": TEXT}, "--board", "b", "--interval", "200us") == 0
    assert bring({"text300.txt": TEXT}, "--board", "b", "--interval", "300us") == 0
    assert sorted(group.runs for group in groups(tmp_path)) == [("a",), ("same", "text"), ("text200",), ("text300",)]
    parameters = {group.runs[0]: group.parameters for group in groups(tmp_path)}
    assert parameters["same"] == {"threads": 2, "cpu_dma_latency_us": 0}  # what the text states, and no default
    assert parameters["text200"] == {"threads": 2, "cpu_dma_latency_us": 0, "interval_us": 200}


def test_host_kernel_times_and_preempt_rt_are_those_of_the_file(tmp_path, bring):
    assert bring({"c.json": FIFO.read_text(), "j.json": JITTERDEBUGGER}) == 0
    cyclictest, jitter = (read_record(tmp_path / "out" / name) for name in ("c", "j"))
    target = cyclictest.target
    assert target.name.startswith("vm (in, ") and not target.is_identified
    assert (target.kernel_release, target.machine, target.preempt_rt) == ("6.18.44-fc-v657", "x86_64", False)
    assert target.kernel_version == "#1 SMP PREEMPT_DYNAMIC @0"
    assert (cyclictest.start_time, cyclictest.end_time) == ("2026-11-26T11:18:02+00:00", "2026-11-26T11:18:04+00:00")
    assert cyclictest.duration_s == 2
    assert jitter.target.name.startswith("board (in, ") and jitter.target.preempt_rt is True
    assert (jitter.target.kernel_release, jitter.start_time) == ("6.1.0", "unknown")


@pytest.mark.parametrize(
    ("system", "is_rt"),
    [
        ({"realtime": 1}, True),
        ({"realtime": 0, "version": "#1 SMP PREEMPT_RT Debian 6.12"}, True),  # of mainline, which has no such file
        ({"version": "#1 SMP PREEMPT RT"}, True),
        ({"version": "#1 SMP PREEMPT_DYNAMIC"}, False),
    ],
)
def test_preempt_rt(tmp_path, bring, system, is_rt):
    assert bring({"c.json": changed(system=system)}) == 0
    assert read_record(tmp_path / "out" / "c").target.preempt_rt is is_rt


def test_nothing_is_made_up_where_a_file_states_nothing(tmp_path, bring):
    data = changed()
    for key in ("sysinfo", "start_time", "end_time", "return_code"):
        del data[key]
    assert bring({"c.json": data}) == 0
    record = read_record(tmp_path / "out" / "c")
    assert record.target.name.startswith("unknown (in, ") and record.target.preempt_rt is None
    assert (record.target.kernel_release, record.start_time, record.status) == (None, "unknown", RunStatus.OK)


def test_a_run_that_failed_is_in_no_group(tmp_path, bring, capsys):
    assert bring({"good.json": FIFO.read_text(), "bad.json": changed(return_code=1)}) == 0
    assert f"{tmp_path}/out/bad: failed: return_code: 1, expected 0" in capsys.readouterr().out
    assert read_record(tmp_path / "out" / "bad").status is RunStatus.FAILED
    analysed = study(tmp_path / "out")
    assert [group.runs for group in analysed.groups] == [("good",)]
    assert analysed.left_out == ("bad: failed: return_code: 1, expected 0",)


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (changed(), ["--unit", "ns"], "its values are in us, but --unit says ns"),
        (changed(), ["--interval", "1ms"], "its interval is 200us, but --interval says 1ms"),
        (changed(), ["--kernel", "6.1"], "its kernel is 6.18.44-fc-v657, but --kernel or --names says 6.1"),
        (changed(), ["--start", "2026-11-25"], "begun at 2026-11-26T11:18:02+00:00, but --start or --names says 2026"),
        (JITTERDEBUGGER, ["--unit", "ns"], "its values are in us, but --unit says ns"),
    ],
)
def test_an_option_that_contradicts_the_file_is_refused(tmp_path, bring, capsys, content, options, message):
    assert bring({"c.json": content}, *options) == 2
    error = capsys.readouterr().err
    assert message in error and "c.json: " in error
    assert not (tmp_path / "out").exists()


def test_options_that_agree_with_the_file_are_taken(tmp_path, bring):
    agreeing = ["--unit", "us", "--interval", "200us", "--kernel", "6.18.44-fc-v657", "--start", "2026-11-26"]
    assert bring({"c.json": changed()}, *agreeing, "--board", "b") == 0
    record = read_record(tmp_path / "out" / "c")
    assert record.start_time == "2026-11-26T11:18:02+00:00"  # more exact than the day that the user names
    assert record.target.name == "b" and record.target.is_identified


def test_unit_and_interval_of_a_text_are_given(tmp_path, bring, capsys):
    assert bring({"t.txt": TEXT}, "--unit", "ns", "--interval", "500us") == 0
    printed = capsys.readouterr().out
    assert "the interval" not in printed and "-N" not in printed
    (group,) = groups(tmp_path)
    assert group.histogram.bin_ns == 1 and group.histogram.max_ns == 740
    assert {digest.header.period_ns for digest in group.digests} == {500_000.0}
    assert bring({"j.json": JITTERDEBUGGER}, "--interval", "500us") == 0
    assert read_record(tmp_path / "out" / "j").parameters == {"interval_us": 500}
    assert "the interval" not in capsys.readouterr().out


@pytest.mark.parametrize("interval", ["0us", "1.5us", "61s", "200"])
def test_what_is_no_interval(bring, capsys, interval):
    assert bring({"t.txt": TEXT}, "--interval", interval) == 2
    assert "--interval" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(system={"nodename": "x" * 65}), "sysinfo.nodename: expected one line of at most 64"),
        (changed(system={"nodename": "\x1b]0;owned\x07"}), "sysinfo.nodename: expected one line"),
        (changed(system={"release": "6.1\n6.2"}), "sysinfo.release: expected one line"),
        (changed(system={"version": 5}), "sysinfo.version: expected one line"),
        (changed(system={"machine": ["x"]}), "sysinfo.machine: expected one line"),
        (changed(system={"realtime": 2}), "sysinfo.realtime: expected 0 or 1"),
        (changed(system={"realtime": True}), "sysinfo.realtime: expected 0 or 1"),
        (changed(return_code="0"), "return_code: expected a whole number"),
        (changed(start_time="yesterday"), "start_time: 'yesterday' is no time"),
        (changed(end_time="Thu, 26 Nov 9999 11:18:02 +0000"), "end_time: 'Thu, 26 Nov 9999 11:18:02 +0000' is no time"),
        (changed(start_time="T" * 70), "start_time: expected one line of at most 64"),
        (changed(cpus=[-2]), "thread.0.cpu: expected -1 to 8191"),
        (changed(cpus=[0, "1"]), "thread.1.cpu: expected -1 to 8191"),
        (changed(words="\x1b[2J"), "cmdline:: expected one line"),
        (changed() | {"sysinfo": []}, "sysinfo: expected a mapping"),
        ("# /dev/cpu_dma_latency set to 4294967296us\n# Histogram\n", ":1: expected at most 2147483647 us"),
    ],
)
def test_hostile_texts_are_refused_with_their_place(tmp_path, bring, capsys, content, message):
    name = "c.txt" if isinstance(content, str) else "c.json"
    assert bring({name: content}) == 2
    error = capsys.readouterr().err
    assert message in error and name in error
    assert "\x1b" not in error and "\x07" not in error


def test_more_than_ours_take_is_read_back(tmp_path, bring):
    """What cyclictest takes and a campaign does not ask for: priority 99, a short interval, many threads."""
    data = changed(words="-p 99 -i 20 --latency=2000000")
    assert bring({"c.json": data}) == 0
    assert read_record(tmp_path / "out" / "c").parameters["interval_us"] == 20


def test_a_message_of_the_kernel_between_two_bins_is_named(bring, capsys):
    lines = TEXT.splitlines(keepends=True)
    text = "".join([*lines[:5], "[   12.345678] sched: RT throttling activated\n", *lines[5:]])
    assert bring({"k.txt": text}) == 2
    assert "k.txt:6: expected a bin, 'value count count ...', got '[   12.345678] sched: RT" in capsys.readouterr().err


def test_a_program_that_no_suite_is_of_is_shown_with_what_it_was_given(tmp_path, bring, capsys):
    assert bring({"results.json": JITTERDEBUGGER}, "--interval", "1ms") == 0
    capsys.readouterr()
    assert main(["show", str(tmp_path / "out")]) == 0
    assert "interval_us=1000" in "".join(capsys.readouterr().out.split())
