"""Kernel traces for tests: lines as the kernel writes them, and run directories with traces."""

import json
from collections.abc import Iterable
from pathlib import Path

from written import write_output

from rtrun.causes.events import Event
from rtrun.causes.ftrace import parse
from rtrun.results import run_directory
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus, TargetFacts
from rtrun.targets.inspection.control_groups import ControlGroup
from rtrun.targets.inspection.platform import Platform

SPECIMENS = Path(__file__).parents[1] / "data" / "traces"
OUTPUT = "cyclic_timer_tests_l2500_fq500-tnRTRR"


def events(text: str) -> list[Event]:
    """The events of lines, each of which must be read."""
    parsed = list(parse(text.strip("\n").split("\n")))
    assert None not in parsed
    return [event for event in parsed if event is not None]


def line(us: int, event: str, *, cpu: int = 0, name: str = "x", pid: int = 9, flags: str = "d..2.") -> str:
    """A line of a trace at a moment in microseconds."""
    return f"{name:>16}-{pid:<7} [{cpu:03}] {flags} {us // 10**6:>5}.{us % 10**6:06}: {event}\n"


def switch(
    us: int, before: tuple[str, int, int], after: tuple[str, int, int], *, state: str = "S", cpu: int = 0
) -> str:
    """A switch from one thread to another, each as (name, pid, prio)."""
    prev, following = (
        f"{which}_comm={name} {which}_pid={pid} {which}_prio={prio}"
        for which, (name, pid, prio) in (("prev", before), ("next", after))
    )
    return line(us, f"sched_switch: {prev} prev_state={state} ==> {following}", cpu=cpu, name=before[0], pid=before[1])


def waking(us: int, pid: int, *, cpu: int = 0, by: int = 9, target: int = 0, flags: str = "d..2.") -> str:
    """A thread is woken by another, or by an interrupt within it (flags with h or s)."""
    event = f"sched_waking: comm=x pid={pid} prio=4 target_cpu={target:03}"
    return line(us, event, cpu=cpu, pid=by, flags=flags)


def head(value_us: int, index: int, at_us: int) -> str:
    """The first line of a trace's file."""
    value = f"{value_us * 1000} ns at index {index} above 100000 ns"
    at = f"{at_us // 10**6}.{at_us % 10**6:06} s of CLOCK_MONOTONIC_RAW"
    return f"# cyclic_timer_tests: {value}, at {at}\n"


def write_traced_run(
    folder: Path,
    traces: dict[int, str],
    tids: Iterable[int],
    output: str = OUTPUT,
    control_groups: Iterable[ControlGroup] = (),
) -> Path:
    """A closed run directory with the files of traces by index, whose program had these threads and control groups.

    An output of messages has the suite communication_tests.
    """
    is_message = output.startswith(("ct_", "1ct_"))
    suite = "communication_tests" if is_message else "cyclic_timer_tests"
    last = (0, 1) if is_message else (1_000_000, 3_000_000)
    rows = [(1_000_000, 1_100_000, last[0]), (3_000_000, 3_100_000, last[1])]
    partial = folder / "partial"
    partial.mkdir(parents=True)
    path = write_output(
        partial, output, suite, rows, requested={"frequency_hz": 500}, asked=2, measured=len(rows) - (not is_message),
    )  # fmt: skip
    record = json.loads(path.read_text())
    thread = record["in_effect"]["threads"][0]
    record["in_effect"]["threads"] = [{**thread, "tid": tid, "name": suite[:15]} for tid in tids]
    path.write_text(json.dumps(record))
    for index, text in traces.items():
        (partial / f"{output}-trace-{index}.txt").write_text(text)
    closing = RunRecord(
        schema=2, run="001-run", campaign="campaign", suite=suite,
        parameters={"policy": "RR", "frequency_hz": 500, "repetitions": 2, "trace_threshold_us": 100},
        platform=Platform.HARDWARE, platform_evidence="stated by the test",
        status=RunStatus.OK, reason=None, start_time="2026-11-21T10:00:00+00:00",
        end_time="2026-11-21T10:00:01+00:00", outputs=[output],
        programs=[ProgramRecord(name=suite, argv=[suite], exit_status=0, control_groups=list(control_groups))],
        target=TargetFacts(name="board", cpus=2, boot_id="1-1"), files={},
    )  # fmt: skip
    run_directory.close(partial, folder / "001-run", closing)
    return folder / "001-run"


def specimen(index: int) -> str:
    """A trace that was recorded on a real machine (tests/data/traces/README.md)."""
    return next(SPECIMENS.glob(f"*-trace-{index}.txt")).read_text()
