"""oneshot_timer_tests and cyclic_timer_tests on a real ROS master."""

import json
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from rtrun.results.figures_so_far import read_figures
from rtrun.targets.inspection.kernel_trace import read_events

from .conftest import (
    PROGRAMS,
    Bench,
    check_outputs,
    check_that_skipped_periods_make_up_the_time,
    defaults_of,
    end,
    is_measuring,
    series_of,
    wait_until,
)

pytestmark = pytest.mark.ros

TRACE_SCRIPT = Path(__file__).parents[2] / "runner/rtrun/on_target/trace.sh"
LISTS = ["\tINFO: Indices of top values(|latency:index|): |", "\tINFO: Indices of lowest values(|latency:index|): |"]


def test_oneshot_defaults(bench: Bench) -> None:
    ended = bench.run("oneshot_timer_tests")
    assert (ended.status, ended.err) == (0, "")
    base = "oneshot_timer_tests_l1000_tm1000"
    logs = [f"{base}-{name}.log" for name in ("diff", "measured", "reported")]
    assert bench.files() == sorted([*logs, f"{base}.json", f"{base}.npy"])
    expected = [
        "\tINFO: Performing ROS Timer latency measurements...",
        "\tINFO: Running in default mode",
        "\tINFO: Measurement results with a loop length of 1000 and a timeout of 1000 us:",
        "\tINFO: Measured:\tMIN:  ",
        "\tINFO: Reported:\tMIN:  ",
        "\tINFO: Difference:\tMIN: ",
        *LISTS,
    ]
    assert [line[: len(start)] for line, start in zip(ended.lines, expected, strict=True)] == expected
    record = check_outputs(bench.folder, base)
    assert record["complete"] is True
    # None is lost to the race in roscpp that made timers "randomly ignored" in 2014.
    assert record["counts"]["measured"] == record["counts"]["asked"] == 1000
    assert {thread["policy"] for thread in record["in_effect"]["threads"]} == {"OTHER"}
    assert record["in_effect"]["clock"] == "CLOCK_MONOTONIC_RAW"
    assert record["in_effect"]["mlockall"] is False
    assert np.load(bench.folder / f"{base}.npy").shape == (1000, 5)


@pytest.mark.root
@pytest.mark.parametrize("policy", ["RR", "FIFO"])
@pytest.mark.parametrize("busy", ["0", "1"])
def test_oneshot_in_real_time(bench: Bench, policy: str, busy: str) -> None:
    ended = bench.run("oneshot_timer_tests", "-s", policy, "-b", busy, "-r", "100", "-t", "2000", "-p", "a b_")
    assert (ended.status, ended.err) == (0, "")
    record = check_outputs(
        bench.folder, f"a b_oneshot_timer_tests_l100_tm2000-tnRT{policy}" + ("-bm" if busy == "1" else "")
    )
    assert record["in_effect"]["mlockall"] is True
    threads = record["in_effect"]["threads"]
    assert {(thread["policy"], thread["priority"]) for thread in threads} == {(policy, 95)}
    assert len(threads) > 4  # those of roscpp, too
    assert f"\tINFO: Running in {'busy' if busy == '1' else 'default'} mode" in ended.lines


@pytest.mark.root
def test_cyclic_at_seven_kilohertz(bench: Bench) -> None:
    ended = bench.run("cyclic_timer_tests", "-s", "RR", "-f", "7000", "-r", "700")
    assert (ended.status, ended.err) == (0, "")
    assert ended.lines[:2] == [
        "\tINFO: Performing latency measurements...",
        "\tINFO: Measurement results with a total of 700 measurements and a frequency of 7000Hz:",
    ]
    assert ended.lines[2].startswith("\tINFO: Jitter:\tMIN: ")
    base = "cyclic_timer_tests_l700_fq7000-tnRTRR"
    assert bench.files() == [f"{base}.json", f"{base}.log", f"{base}.npy"]
    record = check_outputs(bench.folder, base)
    assert record["counts"]["asked"] == record["counts"]["measured"] == 700
    assert np.load(bench.folder / f"{base}.npy").shape == (701, 3)


@pytest.mark.root
def test_only_the_measuring_threads_in_real_time(bench: Bench) -> None:
    asked = ("-s", "FIFO", "--rt-scope", "measuring-thread", "--priority", "40", "--cpu", "0", "-r", "50")
    for program, base in {
        "oneshot_timer_tests": "oneshot_timer_tests_l50_tm1000-tnRTFIFO",
        "cyclic_timer_tests": "cyclic_timer_tests_l50_fq1000-tnRTFIFO",
    }.items():
        assert bench.run(program, *asked).status == 0
        threads = check_outputs(bench.folder, base)["in_effect"]["threads"]
        policies = [(thread["policy"], thread["priority"]) for thread in threads]
        # The measuring thread, roscpp's thread that waits for the timer, and the spinning thread of the one-shot timer.
        assert policies.count(("FIFO", 40)) == (3 if program == "oneshot_timer_tests" else 2)
        assert set(policies) == {("FIFO", 40), ("OTHER", 0)}
        assert all(thread["cpus"] == [0] for thread in threads)


def test_a_timeout_of_zero(bench: Bench) -> None:
    assert bench.run("oneshot_timer_tests", "-t", "0", "-r", "200").status == 0
    record = check_outputs(bench.folder, "oneshot_timer_tests_l200_tm0")
    assert (record["complete"], record["counts"]["measured"]) == (True, 200)
    assert record["summary"]["measured"]["min_ns"] > 0


@pytest.mark.root
@pytest.mark.parametrize("frequency", [200_000, 1_000_000_000])
def test_a_frequency_that_the_timer_cannot_keep(bench: Bench, frequency: int) -> None:
    """Every period is measured; each is too long by what roscpp needs for a call."""
    assert bench.run("cyclic_timer_tests", "-f", str(frequency), "-r", "2000", "-s", "FIFO").status == 0
    record = check_outputs(bench.folder, f"cyclic_timer_tests_l2000_fq{frequency}-tnRTFIFO")
    assert (record["complete"], record["counts"]["measured"]) == (True, 2000)
    assert record["summary"]["jitter"]["max_ns"] > 0
    check_that_skipped_periods_make_up_the_time(record["rate"], 2000)


def test_a_timer_that_was_stopped_skipped_periods(bench: Bench) -> None:
    """roscpp moves its grid, so that no call after the pause is late: the periods without a call are counted."""
    process = bench.start("cyclic_timer_tests", "-f", "100", "-r", "300")
    wait_until(lambda: is_measuring(process), process)
    time.sleep(0.3)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.5)
    process.send_signal(signal.SIGCONT)
    assert end(process).status == 0
    rate = check_outputs(bench.folder, "cyclic_timer_tests_l300_fq100")["rate"]
    assert rate["overruns"] >= 1 and rate["skipped"] >= 45


@pytest.mark.root
@pytest.mark.parametrize("program", PROGRAMS)
def test_idle_cpus_are_held_awake_where_asked_for(bench: Bench, program: str) -> None:
    """The device is open while measuring, and only if it was asked for; what the kernel reports is recorded."""
    device = Path("/dev/cpu_dma_latency")
    for option, holds in ((("--cpu-dma-latency", "7"), True), ((), False)):
        process = bench.start(program, "-r", "100000", "-p", str(holds), *option)
        wait_until(lambda process=process: is_measuring(process), process)
        opened = [link.readlink() for link in Path(f"/proc/{process.pid}/fd").iterdir()]
        assert opened.count(device) == holds
        process.terminate()
        end(process)
        (path,) = bench.folder.glob(f"{holds}*.json")
        record = json.loads(path.read_text())
        assert record["requested"]["cpu_dma_latency_us"] == (7 if holds else None)
        # Others on this machine may hold a lower one, or none.
        in_effect_us = record["in_effect"]["cpu_dma_latency_us"]
        assert 0 <= in_effect_us <= (7 if holds else 2**31)


def locked_kib(process: "subprocess.Popen[str]") -> int:
    """Locked memory of a process, in KiB."""
    return int(re.search(r"^VmLck:\s+(\d+) kB$", Path(f"/proc/{process.pid}/status").read_text(), re.M)[1])  # type: ignore[index]


def page_faults(process: "subprocess.Popen[str]") -> int:
    """Page faults of all threads of a process so far, minor and major."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return int(fields[7]) + int(fields[9])


@pytest.mark.root
@pytest.mark.parametrize(
    "command",
    [
        ("oneshot_timer_tests", "-t", "1000"),
        ("cyclic_timer_tests", "-f", "1000"),
        ("communication_tests_subscriber", "--idle-timeout", "10"),
        ("communication_tests_publisher", "-f", "1000"),
    ],
    ids=lambda command: command[0],
)
def test_locked_memory_is_bounded_and_never_faults(bench: Bench, command: tuple[str, ...]) -> None:
    """A board may have 256 MiB. Libraries, heap, and 256 KiB of stack for each thread stay in memory."""
    process = bench.start(*command, "-s", "RR", "-r", "4000")
    wait_until(lambda: is_measuring(process), process)
    time.sleep(0.5)
    before = page_faults(process)
    time.sleep(1)
    assert page_faults(process) == before
    assert 4_000 < locked_kib(process) < 24_000
    process.terminate()
    assert end(process).status == (1 if "publisher" in command[0] else 0)
    (path,) = bench.folder.glob("*.json")
    costs = json.loads(path.read_text())["costs"]
    if "subscriber" in command[0]:
        assert costs is None  # no message came
    else:
        assert costs["minor_faults"] == costs["major_faults"] == 0
        assert costs["voluntary_switches"] > 500 and costs["cpu_time_ns"] > 10**6


def test_out_dir_prefix_and_clock(bench: Bench) -> None:
    (bench.folder / "out" / "logs").mkdir(parents=True)
    ended = bench.run(
        "cyclic_timer_tests", "-r", "20", "--out-dir", "out", "-p", "logs/x_", "--clock=monotonic", "__name:=other"
    )
    assert ended.status == 0
    folder = bench.folder / "out" / "logs"
    record = check_outputs_below(folder, "x_cyclic_timer_tests_l20_fq1000")
    assert record["in_effect"]["clock"] == "CLOCK_MONOTONIC"


def check_outputs_below(folder: Path, output: str) -> dict:
    """As a drop-in replacement, the log names its picture with the folder of the prefix."""
    log = folder / f"{output}.log"
    assert f'set output "logs/{output}.jpg"' in log.read_text()
    log.write_text(log.read_text().replace(f'"logs/{output}', f'"{output}'))
    return check_outputs(folder, output)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("program", ["oneshot_timer_tests", "cyclic_timer_tests"])
def test_a_signal_ends_it_with_what_it_has(bench: Bench, program: str, number: signal.Signals) -> None:
    # Ten seconds a shot: the signal finds the program waiting.
    slow = ("-t", "10000000") if program == "oneshot_timer_tests" else ("-f", "1")
    process = bench.start(program, *slow, "-r", "1000")
    wait_until(lambda: is_measuring(process), process)
    process.send_signal(number)
    ended = end(process, timeout=10)
    assert (ended.status, ended.err) == (0, "")
    base = program + ("_l1000_tm10000000" if program == "oneshot_timer_tests" else "_l1000_fq1")
    record = check_outputs(bench.folder, base)
    assert record["incomplete_reason"] == f"ended by {number.name}"
    assert record["counts"]["measured"] <= 1
    assert ended.lines[-1] == (
        f"\tINFO: Incomplete: {record['counts']['measured']} of 1000 measured, ended by {number.name}"
    )


def test_busy_mode_ends_on_a_signal(bench: Bench) -> None:
    process = bench.start("oneshot_timer_tests", "-b", "1", "-r", "1000000")
    wait_until(lambda: is_measuring(process), process)
    process.terminate()
    assert end(process, timeout=10).status == 0
    assert check_outputs(bench.folder, "oneshot_timer_tests_l1000000_tm1000-bm")["complete"] is False


@pytest.mark.root
@pytest.mark.parametrize(
    ("program", "mode"), [("oneshot_timer_tests", "-b0"), ("oneshot_timer_tests", "-b1"), ("cyclic_timer_tests", "")]
)
def test_the_program_allocates_nothing_per_measurement(bench: Bench, unit_build: Path, program: str, mode: str) -> None:
    """The real loop, on roscpp: twenty times the measurements cost the program's own code not one allocation more.

    Allocations inside roscpp are counted apart: it makes a callback object for each expiry, as it did in 2014.
    """
    preload = ("env", f"LD_PRELOAD={unit_build / 'libcount_allocations.so'}")
    counts = []
    for repetitions in ("50", "1000"):
        arguments = ["-s", "RR", "-r", repetitions, *([mode[:2], mode[2:]] if mode else [])]
        ended = bench.run(program, *arguments, before=preload)
        assert ended.status == 0
        counts.append(
            [int(n) for n in re.findall(r"^allocations: program (\d+), libraries (\d+)$", ended.err, re.M)[0]]
        )
    (few, few_of_ros), (many, many_of_ros) = counts
    assert few == many > 0
    assert many_of_ros - few_of_ros >= 950  # the counter sees what there is to see


def test_ros_ends_it(bench: Bench) -> None:
    """A second node of the same name makes the master shut the first one down."""
    for program, base in {
        "oneshot_timer_tests": "oneshot_timer_tests_l1000_tm10000000",
        "cyclic_timer_tests": "cyclic_timer_tests_l1000_fq1",
    }.items():
        slow = ("-t", "10000000") if program == "oneshot_timer_tests" else ("-f", "1")
        first = bench.start(program, *slow)
        wait_until(lambda first=first: is_measuring(first), first)
        second = bench.start(program, *slow, "-p", "second_")
        assert end(first, timeout=20).status == 0
        assert check_outputs(bench.folder, base)["incomplete_reason"] == "ended by ROS"
        second.kill()


def traced(more: str = ":") -> tuple[str, ...]:
    """Start a program with the runner's trace instance, in a mount namespace that ends with it.

    `more` is a shell command that runs between setting up the trace and starting the program.
    """
    instance = "/sys/kernel/tracing/instances/rtrun"
    events = " ".join(read_events())
    script = (
        "test -e /sys/kernel/tracing/trace_marker || mount -t tracefs tracefs /sys/kernel/tracing || exit; "
        f'sh "{TRACE_SCRIPT}" up mono_raw {events} && {more} || exit; "$@"; status=$?; '
        f'sh "{TRACE_SCRIPT}" down; test ! -e {instance} || status=99; exit $status'
    )
    return ("unshare", "--mount", "sh", "-c", script, "sh")


EVENT = re.compile(r"^ +.*-\d+ +\[\d+\] .* (\d+\.\d{6}): (\w+): ", re.M)


# Whose values the limit of a trace is held against, and the options that say so.
TRACED = pytest.mark.parametrize(
    ("program", "series", "options"),
    [
        ("oneshot_timer_tests", "measured", ()),
        ("cyclic_timer_tests", "lateness", ()),
        ("cyclic_timer_tests", "jitter", ("--trace-of", "jitter")),
    ],
    ids=["oneshot", "lateness", "jitter"],
)


@pytest.mark.trace
@TRACED
def test_break_trace_keeps_the_kernel_trace(bench: Bench, program: str, series: str, options: tuple[str, ...]) -> None:
    ended = bench.run(program, "-r", "5000", "--break-trace", "1", *options, before=traced())
    assert ended.status == 0
    base = f"{program}_l5000_" + ("tm1000" if program == "oneshot_timer_tests" else "fq1000")
    record = check_outputs(bench.folder, base)
    value_ns, index = re.fullmatch(
        r"ended by --break-trace: (\d+) ns at index (\d+)", record["incomplete_reason"]
    ).groups()  # type: ignore[union-attr]
    assert int(index) == record["counts"]["measured"] - 1
    assert int(value_ns) == record["summary"][series]["max_ns"] > 1000
    assert record["traces"] == {"above_limit": 1, "files": [f"{base}-trace-{index}.txt"]}
    text = (bench.folder / f"{base}-trace-{index}.txt").read_text()
    above = f"{program}: {value_ns} ns at index {index} above 1000 ns"
    assert text.startswith(f"# {above}, at ")
    assert f": tracing_mark_write: {above}\n" in text


@pytest.mark.trace
@TRACED
def test_threshold_keeps_traces_and_goes_on(bench: Bench, program: str, series: str, options: tuple[str, ...]) -> None:
    """Each trace holds what the kernel did when its value came, on the clock of the samples."""
    # On a busy machine the thread that copies comes late: a larger buffer still holds the value then.
    larger = traced("echo 4096 >/sys/kernel/tracing/instances/rtrun/buffer_size_kb")
    period = ("-t", "5000") if program == "oneshot_timer_tests" else ("-f", "200")
    ended = bench.run(program, "-r", "200", *period, "--trace-threshold", "1", *options, before=larger)
    assert (ended.status, ended.err) == (0, "")
    base = f"{program}_l200_" + ("tm5000" if program == "oneshot_timer_tests" else "fq200")
    record = check_outputs(bench.folder, base)
    assert record["complete"] is True
    rows = np.load(bench.folder / f"{base}.npy")
    values = np.array(series_of(record, rows)[series][0])
    ends = rows[:, 1] if program == "oneshot_timer_tests" else rows[1:, 0]
    above = [int(index) for index in np.flatnonzero(values > 1000)]
    assert record["traces"] == {
        "above_limit": len(above),
        "files": [f"{base}-trace-{index}.txt" for index in above[:16]],
    }
    assert f"\tINFO: Kernel traces: {len(above[:16])} of {len(above)} values above the limit" in ended.lines
    for index, name in zip(above, record["traces"]["files"], strict=False):
        text = (bench.folder / name).read_text()
        at_s = f"{ends[index] // 10**9}.{ends[index] // 1000 % 10**6:06d}"
        assert text.startswith(
            f"# {program}: {values[index]} ns at index {index} above 1000 ns, at {at_s} s of CLOCK_MONOTONIC_RAW\n"
        )
        if elsewhere := re.search(r"^# in (.*)$", text, re.M):
            text = (bench.folder / elsewhere[1]).read_text()
        events = [(float(stamp), event) for stamp, event in EVENT.findall(text)]
        assert {"sched_switch", "sched_waking"} <= {event for _, event in events}
        assert events[0][0] < float(at_s) < events[-1][0]


def test_full_disk(bench: Bench) -> None:
    ended = bench.run(
        "oneshot_timer_tests", "-r", "300", before=("prlimit", "--fsize=4096", "env", "--ignore-signal=XFSZ")
    )
    assert ended.status == 1
    assert ended.err == "\tERROR: cannot write oneshot_timer_tests_l300_tm1000.npy: File too large\n"
    assert bench.files() == []


def test_what_was_requested_is_what_suites_yml_says(bench: Bench) -> None:
    for program, base in {
        "oneshot_timer_tests": "oneshot_timer_tests_l5_tm1000",
        "cyclic_timer_tests": "cyclic_timer_tests_l5_fq1000",
    }.items():
        assert bench.run(program, "-r", "5").status == 0
        requested = check_outputs(bench.folder, base)["requested"]
        assert requested == defaults_of(program) | {"repetitions": 5}


@pytest.mark.root
def test_blocks_survive_a_kill(bench: Bench) -> None:
    """What a power cut leaves of a long run, but for what the disk itself would lose: the part, and figures of it."""
    process = bench.start("cyclic_timer_tests", "-s", "FIFO", "-r", "100000")
    base = "cyclic_timer_tests_l100000_fq1000-tnRTFIFO"
    part = bench.folder / f"{base}.npy.part"
    wait_until(lambda: part.exists() and part.stat().st_size > 128, process)
    process.kill()
    process.communicate()
    live = bench.folder / f"{base}.live"
    assert bench.files() == [live.name, part.name]
    header, values = part.read_bytes()[:128], np.frombuffer(part.read_bytes()[128:], dtype="<i8")
    # The kill may come in the middle of a write.
    rows = values[: values.size // 3 * 3].reshape(-1, 3)
    assert b"'shape': (100001, 3)" in header
    # Not one row of zeros, none out of place.
    assert 0 < len(rows) < 100001
    assert (np.diff(rows[:, 0]) > 0).all()
    assert rows[-1, 0] - rows[0, 0] < 60e9
    figures = read_figures(live.read_text())
    assert figures is not None and figures.n < 100001
    lateness = rows[1:, 2] - rows[1:, 1]
    assert figures.max_ns >= lateness[: figures.n].max()


@pytest.mark.root
@pytest.mark.parametrize("program", ["oneshot_timer_tests", "cyclic_timer_tests"])
def test_a_long_run_leaves_no_part(bench: Bench, program: str) -> None:
    """The writer is there, of normal priority, and says what it could not write; the results are as ever."""
    base = f"{program}_l600_" + ("tm10000" if program == "oneshot_timer_tests" else "fq100") + "-tnRTRR"
    (bench.folder / f"{base}.npy.part").symlink_to("/dev/full")
    period = ("-t", "10000") if program == "oneshot_timer_tests" else ("-f", "100")
    ended = bench.run(program, "-s", "RR", "-r", "600", *period)
    assert ended.status == 0
    assert ended.err == (
        f"\tWARNING: cannot write {base}.npy.part: No space left on device; "
        "a power cut would have lost all but the first 0 rows\n"
    )
    record = check_outputs(bench.folder, base)
    assert record["complete"] is True
    assert not any(name.endswith(".part") for name in bench.files())
    policies = {thread["name"]: thread["policy"] for thread in record["in_effect"]["threads"]}
    assert policies.pop("rt_blocks") == "OTHER"
    assert set(policies.values()) == {"RR"}
