"""Outputs and run directories as docs/formats.md describes them, written for the tests of their readers."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtrun.execution.stream_runs import StreamFacts
from rtrun.plan import suites
from rtrun.plan.observation import StreamDeadline
from rtrun.results.record import ProgramRecord, read_record
from rtrun.targets.inspection.facts import TargetState

NOT_FIRED = -(2**63)
OTHER = {"policy": "OTHER", "priority": 0}
Rows = list[tuple[int, ...]] | NDArray[np.int64]


def write_npy(path: Path, rows: Rows, announced: int | None = None) -> None:
    """Write rows by hand in NumPy format 1.0; a part announces more of them."""
    array = np.array(rows, dtype="<i8")
    header = f"{{'descr': '<i8', 'fortran_order': False, 'shape': ({announced or len(array)}, {array.shape[1]}), }}"
    header += " " * (-(10 + len(header) + 1) % 64) + "\n"
    magic = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little")
    path.write_bytes(magic + header.encode() + array.tobytes())


def write_output(
    folder: Path,
    output: str,
    suite: str,
    rows: Rows,
    *,
    requested: dict[str, Any],
    logs: list[str] | None = None,
    **counts: int,
) -> Path:
    """Write ``<output>.npy`` and ``<output>.json``. Returns the json's path.

    Counts that are not given are 0, and the only log is ``<output>.log`` unless `logs` names others.
    """
    write_npy(folder / f"{output}.npy", rows)
    policy = requested.get("policy", "RR")
    measuring = OTHER if policy == "0" else {"policy": policy, "priority": 95}
    names = ("asked", "measured", "not_fired", "missing", "duplicate", "out_of_order")
    record = {
        "schema": 1,
        "suite": suite,
        "program": suite,
        "version": "0.1.0",
        "complete": True,
        "incomplete_reason": None,
        "requested": {"policy": "RR", "priority": 95, "cpu": "", "break_trace_us": None, **requested},
        "in_effect": {
            "threads": [
                {"tid": 123, "name": suite[:15], **measuring, "cpus": [0, 1]},
                {"tid": 124, "name": "rt_blocks", **OTHER, "cpus": [0, 1]},
            ],
            "clock": "CLOCK_MONOTONIC_RAW",
            "clock_resolution_ns": 1,
            "clock_step_ns": 16,
            "mlockall": True,
        },
        "host": "board",
        "kernel": {"release": "6.1.0-rt", "version": "#1 SMP PREEMPT_RT", "machine": "armv7l"},
        "start_time": "2026-11-21T10:00:00Z",
        "end_time": "2026-11-21T10:00:01Z",
        "counts": dict.fromkeys(names, 0) | counts,
        "indices": {"not_fired": [], "missing": [], "duplicate": [], "out_of_order": []},
        "summary": {"x": {"n": 0, "min_ns": None, "mean_ns": None, "max_ns": None, "top": [], "lowest": []}},
        "files": {"logs": [f"{output}.log"] if logs is None else logs, "npy": f"{output}.npy"},
        "columns": [*suites.suite(suite).columns],
        "rate": dict.fromkeys(("asked_hz", "achieved_hz", "overruns", "skipped")),
        "traces": {"above_limit": 0, "files": []},
    }
    path = folder / f"{output}.json"
    path.write_text(json.dumps(record))
    return path


def write_oneshot(folder: Path, armed_after_ns: int = 7000) -> Path:
    """Four one-shot measurements of 1 ms, each armed so long after its start, the third of which never fired."""
    rows = [
        (10, 1_050_010, 50_000, 58_000),
        (2_000_000, 3_060_000, 60_000, 67_500),
        (4_000_000, NOT_FIRED, NOT_FIRED, NOT_FIRED),
        (9_000_000, 10_000_100, 100, -400),
    ]
    return write_output(
        folder,
        "oneshot_timer_tests_l4_tm1000-tnRTRR",
        "oneshot_timer_tests",
        [(*row, row[0] + armed_after_ns) for row in rows],
        requested={"repetitions": 4, "timeout_us": 1000, "busy_mode": 0},
        asked=4,
        measured=3,
        not_fired=1,
    )


def write_cyclic(folder: Path) -> Path:
    """Four calls of a 7 kHz timer, whose period is no whole number of nanoseconds."""
    rows = [(1000, 0, 9), (143_857 + 500, 142_857, 142_866), (286_714, 285_714, 285_723), (429_571, 428_571, 428_580)]
    return write_output(
        folder,
        "cyclic_timer_tests_l3_fq7000-tnRTRR",
        "cyclic_timer_tests",
        rows,
        requested={"repetitions": 3, "frequency_hz": 7000},
        asked=3,
        measured=3,
    )


def write_communication(folder: Path, prefix: str = "") -> Path:
    """Five messages sent: 2 arrived before 1, 3 came twice (its first arrival counts), 4 never."""
    rows = [(1000, 201_000, 0), (3000, 303_000, 2), (2000, 402_000, 1), (4000, 104_000, 3)]
    return write_output(
        folder,
        f"{prefix}ct_gnuplot_l5_fq100_pl0-tnRTRR",
        "communication_tests",
        rows,
        requested={"repetitions": 5, "frequency_hz": 100, "payload_bytes": 0, "prefix": prefix},
        asked=5,
        measured=4,
        missing=1,
        duplicate=1,
        out_of_order=1,
    )


def write_record(folder: Path, suite: str, outputs: list[str], parameters: dict[str, Any], **changed: Any) -> Path:
    """Close a run directory over the files in it; `changed` replaces keys of run.json."""
    files = {
        path.name: {"size_bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for path in sorted(folder.iterdir())
    }
    record = {
        "schema": 2,
        "run": folder.name,
        "campaign": "demo",
        "suite": suite,
        "parameters": parameters,
        "platform": "hardware",
        "platform_evidence": "stated by the test",
        "status": "ok",
        "reason": None,
        "start_time": "2026-11-21T10:00:00Z",
        "end_time": "2026-11-21T10:00:01Z",
        "programs": [{"name": suite, "argv": [suite], "exit_status": 0}],
        "outputs": outputs,
        "target": {"name": "board", "kernel_release": "6.1.0-rt", "kernel_version": "#1 SMP PREEMPT_RT", "cpus": 2},
        "files": files,
    }
    path = folder / "run.json"
    path.write_text(json.dumps(record | changed))
    return path


def stream_facts(folder: Path, *deadlines: StreamDeadline, programs: Sequence[ProgramRecord] = ()) -> StreamFacts:
    """What the streams of an observing run share, whose record is written to `folder`, which is made."""
    folder.mkdir()
    write_record(folder, "observed_intervals", [], {}, subject="attached")
    return StreamFacts(
        record=read_record(folder),
        state=TargetState(),
        start_time="2026-11-21T10:00:00Z",
        end_time="2026-11-21T10:01:00Z",
        deadlines=deadlines,
        programs=lambda *_: programs,
    )


def close(folder, *names):
    """Have the files in the record as they are."""
    record = json.loads((folder / "run.json").read_text())
    for name in names:
        content = (folder / name).read_bytes()
        record["files"][name] = {"size_bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    (folder / "run.json").write_text(json.dumps(record))
