"""A results folder as the runner leaves it: journal, goal, run directories, what was measured again as ``.old-<n>``.

Nothing of the project writes here, so that what a reader takes for granted is not taken for granted twice. Histograms
go through ``rtrun import``, as those of a user do.
"""

import hashlib
import io
import json
import sqlite3
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

DEADLINE_NS = 400_000
PERIOD_NS = 1_000_000
CAMPAIGN = "drawn"
SUITES = {
    "oneshot": "oneshot_timer_tests",
    "cyclic": "cyclic_timer_tests",
    "messages": "communication_tests",
    "observed": "observation",
}
UNIX_0 = datetime(1970, 1, 1, tzinfo=UTC)
KERNEL = {"release": "6.1.0-rt", "version": "#1 SMP PREEMPT_RT", "machine": "aarch64"}
_JOURNAL = """
PRAGMA journal_mode=WAL;
CREATE TABLE IF NOT EXISTS campaign (uid TEXT NOT NULL, name TEXT NOT NULL, plan TEXT NOT NULL, target TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS event (time TEXT NOT NULL, run TEXT NOT NULL, what TEXT NOT NULL, reason TEXT);
"""


@dataclass(kw_only=True, slots=True)
class Attempt:
    """One attempt at a run, as it ended on its board.

    `outputs` has the values of each program that measured, int64 nanoseconds in the order of the loops, MISSING where a
    message never came. Of a program that was ended, only so many loops are `kept`, and without its json. `gaps` are
    those of an observation, in ns from its begin; `unseen` are the loops in them.
    """

    run: str
    repeat: int
    board: str
    boot: str | None
    start: datetime
    outputs: list[np.ndarray]
    status: str = "ok"
    reason: str | None = None
    exit_status: int | None = 0
    achieved_hz: float | None = None
    gaps: list[tuple[int, int]] = field(default_factory=list)
    unseen: np.ndarray | None = None
    kept: int | None = None
    uid: str = ""

    @property
    def loops(self) -> int:
        return self.outputs[0].size

    @property
    def end(self) -> datetime:
        return self.start + timedelta(seconds=self.loops * PERIOD_NS / 1e9 + 0.6)


MISSING = -(2**62)


@dataclass(kw_only=True)
class Results:
    """A folder of results that is filled, run by run. `suite` is oneshot, cyclic, messages or observed."""

    folder: Path
    suite: str
    boards: list[str]
    digest: str
    events: list[tuple[str, str, str, str | None]] = field(default_factory=list)

    def begin(self, goal: dict[str, Any] | None) -> None:
        self.folder.mkdir(parents=True)
        (self.folder / ".lock").touch()
        if goal is not None:
            text = json.dumps({"schema": 1, "until": goal}, indent=2) + "\n"
            (self.folder / "goal.json").write_text(text)

    def session(self, when: datetime) -> None:
        """A runner takes up the campaign."""
        self.events.append((when.isoformat(), "", "session", None))

    def commit(self) -> None:
        """Write what has happened since into the journal."""
        database = sqlite3.connect(self.folder / "journal.sqlite")
        try:
            database.executescript(_JOURNAL)
            with database:
                if database.execute("SELECT uid FROM campaign").fetchone() is None:
                    row = (f"{CAMPAIGN}-{self.digest[:8]}", CAMPAIGN, self.digest, " ".join(self.boards))
                    database.execute("INSERT INTO campaign VALUES (?, ?, ?, ?)", row)
                database.executemany("INSERT INTO event VALUES (?, ?, ?, ?)", self.events)
        finally:
            database.close()
        self.events.clear()

    def cut_off(self, attempt: Attempt, why: str) -> None:
        """The board restarted in the middle: what it had written is kept as ``<run>.incomplete-<n>``."""
        self._note_begin(attempt)
        when = attempt.end.isoformat()
        kept = _unused(self.folder / attempt.run, "incomplete")
        self.events += [
            (when, attempt.run, "cut off", why),
            (when, attempt.run, "planned", f"kept as {kept.name}"),
        ]
        kept.mkdir()
        for name, data in self._files(attempt).items():
            (kept / name).write_bytes(data)

    def close(self, attempt: Attempt) -> Path:
        """Close a run; an earlier attempt at it becomes ``.old-<n>``."""
        self._note_begin(attempt)
        when = attempt.end.isoformat()
        said = f"{attempt.status}: {attempt.reason}" if attempt.reason else attempt.status
        self.events += [(when, attempt.run, "ended", None), (when, attempt.run, "closed", said)]
        folder = self.folder / attempt.run
        if folder.exists():
            folder.rename(_unused(folder, "old"))
        folder.mkdir()
        if self.suite == "observed":
            self._close_observed(attempt, folder)
        else:
            fill(folder, self._files(attempt), self.record(attempt))
        return folder

    def _close_observed(self, attempt: Attempt, folder: Path) -> None:
        """A run of what was observed, and beside it one of its stream."""
        from drawn import observed

        beside = folder.with_name(observed.stream_of(attempt))
        if beside.exists():
            beside.rename(_unused(beside, "old"))
        beside.mkdir()
        record = self.record(attempt) | observed.SHARED
        fill(beside, observed.stream_files(attempt), record | observed.stream_record(attempt))
        fill(folder, observed.FILES, record | observed.whole_record(attempt))

    def _note_begin(self, attempt: Attempt) -> None:
        when = attempt.start.isoformat()
        if len(self.boards) > 1:
            self.events.append((when, attempt.run, "given to", attempt.board))
        self.events += [(when, attempt.run, "starting", None), (when, attempt.run, "measuring", None)]

    def _files(self, attempt: Attempt) -> dict[str, bytes]:
        files: dict[str, bytes] = {}
        for number, values in enumerate(attempt.outputs):
            name = self._output(attempt, number)
            rows, counts, columns = _ROWS[self.suite](values, clock_ns(attempt.start) + 1000 * number)
            if attempt.kept is not None:
                # As the runner leaves what was killed: the blocks that were on the disk.
                files[f"{name}.npy"] = npy(rows[: attempt.kept])
                continue
            record = self._suite_json(attempt, name, counts, columns, values.size)
            if self.suite == "messages":
                seen = np.zeros(values.size, bool)
                seen[rows[:, 2]] = True
                record["indices"]["missing"] = np.flatnonzero(~seen)[:1000].tolist()
                record["indices"]["out_of_order"] = rows[1:, 2][np.diff(rows[:, 2]) < 0][:1000].tolist()
            files[f"{name}.json"] = json.dumps(record).encode()
            files[f"{name}.npy"] = npy(rows)
        if self.suite == "messages" and attempt.kept is None:
            name = f"{self._stem(attempt)}-publisher.json"
            record = self._suite_json(attempt, name, {}, [], attempt.loops)
            for key in ("indices", "summary", "files", "columns", "traces"):
                record.pop(key)
            record["program"] = "communication_tests_publisher"
            record["counts"] = {"asked": attempt.loops, "sent": attempt.loops}
            files[name] = json.dumps(record).encode()
        return files

    def _stem(self, attempt: Attempt) -> str:
        n = attempt.loops
        return {
            "oneshot": f"oneshot_timer_tests_l{n}_tm1000-tnRTFIFO",
            "cyclic": f"cyclic_timer_tests_l{n}_fq1000-tnRTFIFO",
            "messages": f"ct_gnuplot_l{n}_fq1000_pl0-tnRTFIFO",
            "observed": "",
        }[self.suite]

    def _output(self, attempt: Attempt, number: int) -> str:
        # Several subscribers have a prefix each.
        return (str(number) if len(attempt.outputs) > 1 else "") + self._stem(attempt)

    def _parameters(self, attempt: Attempt) -> dict[str, Any]:
        common = {"policy": "FIFO", "repetitions": attempt.loops, "priority": 95}
        own = {
            "oneshot": {"timeout_us": 1000, "busy_mode": 0},
            "cyclic": {"frequency_hz": 1000},
            "messages": {"frequency_hz": 1000, "payload_bytes": 0, "subscribers": len(attempt.outputs)},
            "observed": {},
        }
        return common | own[self.suite]

    def _suite_json(
        self, attempt: Attempt, name: str, counts: dict[str, int], columns: list[str], asked: int
    ) -> dict[str, Any]:
        suite = SUITES[self.suite]
        requested = {key: value for key, value in self._parameters(attempt).items() if key != "subscribers"}
        thread = {"tid": 1, "name": suite[:15], "policy": "FIFO", "priority": 95, "cpus": [0, 1]}
        made = program_json(attempt, suite, requested, {"asked": asked, "measured": asked} | counts, columns, name)
        made["in_effect"] |= {"threads": [thread], "clock": "CLOCK_MONOTONIC_RAW", "clock_step_ns": 16}
        made["in_effect"] |= {"mlockall": True, "cpu_dma_latency_us": 2000000000}
        made["rate"] = self._rate(attempt)
        if self.suite == "messages":
            made["program"] = "communication_tests_subscriber"
        return made

    def _rate(self, attempt: Attempt) -> dict[str, Any]:
        achieved = 1e9 / PERIOD_NS if attempt.achieved_hz is None else attempt.achieved_hz
        is_periodic = self.suite in ("cyclic", "messages")
        zero = 0 if is_periodic else None
        asked = 1000 if is_periodic else None
        return {"asked_hz": asked, "achieved_hz": achieved, "overruns": zero, "skipped": zero}

    def record(self, attempt: Attempt) -> dict[str, Any]:
        """run.json of an attempt, without its files."""
        suite = SUITES[self.suite]
        names = {"messages": ["communication_tests_publisher", "communication_tests_subscriber"]}.get(
            self.suite, [suite]
        )
        rate = self._rate(attempt)
        return {
            "schema": 2,
            "run": attempt.run,
            "campaign": CAMPAIGN,
            "attempt": attempt.uid,
            "suite": suite,
            "subject": "started",
            "parameters": self._parameters(attempt),
            "platform": "hardware",
            "platform_evidence": "no sign of a hypervisor",
            "condition": "idle",
            "settings": {},
            "repeat": attempt.repeat,
            "seed": 7,
            "variant": "",
            "kernel": None,
            "trace": "",
            "status": attempt.status,
            "reason": attempt.reason,
            "requested": {"policy": "FIFO", "priority": 95},
            "in_effect": {"policy": ["FIFO"], "priority": [95], "cpus": [0, 1], "observations": 2},
            "start_time": attempt.start.isoformat(),
            "end_time": attempt.end.isoformat(),
            "programs": [
                {
                    "name": name,
                    "argv": [name],
                    "exit_status": attempt.exit_status,
                    "rate": rate if attempt.kept is None else None,
                    "loops": attempt.loops if attempt.kept is None else None,
                }
                for name in names
            ],
            "outputs": [self._output(attempt, number) for number in range(len(attempt.outputs))],
            "refused": {},
            "target": {
                "name": attempt.board,
                "address": f"ssh root@{attempt.board}",
                "preempt_rt": True,
                "cpus": 4,
                "kernel_release": KERNEL["release"],
                "kernel_version": KERNEL["version"],
                "machine": KERNEL["machine"],
                "boot_id": attempt.boot,
                "clock": {"source": "arch_sys_counter", "event": "arch_sys_timer", "step_ns": 16},
            },
        }


def program_json(
    attempt: Attempt, suite: str, requested: dict[str, Any], counts: dict[str, int], columns: list[str], name: str
) -> dict[str, Any]:
    """The json of a program that measured."""
    none = {"asked": 0, "measured": 0, "not_fired": 0, "missing": 0, "duplicate": 0, "out_of_order": 0}
    return {
        "schema": 1,
        "suite": suite,
        "program": suite,
        "version": "0.1.0",
        "complete": True,
        "incomplete_reason": None,
        "requested": requested,
        "in_effect": {
            "threads": [],
            "clock": "CLOCK_MONOTONIC",
            "clock_resolution_ns": 1,
            "clock_step_ns": 1,
            "mlockall": None,
        },
        "host": attempt.board,
        "kernel": KERNEL,
        "start_time": utc(attempt.start),
        "end_time": utc(attempt.end),
        "counts": none | counts,
        "indices": {"not_fired": [], "missing": [], "duplicate": [], "out_of_order": []},
        "rate": {"asked_hz": None, "achieved_hz": 1e9 / PERIOD_NS, "overruns": None, "skipped": None},
        "summary": {},
        "files": {"logs": [], "npy": f"{name}.npy"},
        "columns": columns,
        "traces": {"above_limit": 0, "files": []},
    }


def _oneshot_rows(values: np.ndarray, begin_ns: int) -> tuple[np.ndarray, dict[str, int], list[str]]:
    timeout = 1_000_000
    start = begin_ns + np.r_[0, np.cumsum(values[:-1] + timeout + 20_000)].astype(np.int64)
    rows = np.stack([start, start + timeout + values, values, values - 2000, start + 3000], axis=1)
    return rows, {}, ["start_ns", "end_ns", "measured_ns", "reported_ns", "armed_ns"]


def _cyclic_rows(values: np.ndarray, begin_ns: int) -> tuple[np.ndarray, dict[str, int], list[str]]:
    # The first row is the origin. Calls that are late come one after the other.
    expected = begin_ns + PERIOD_NS * np.arange(values.size + 1)
    real = expected + np.r_[30_000, values]
    stamp = np.maximum.accumulate(real) + 100
    columns = ["timestamp_ns", "expected_ns", "real_ns"]
    return np.stack([stamp, expected, real], axis=1), {"asked": values.size, "measured": values.size}, columns


def _message_rows(values: np.ndarray, begin_ns: int) -> tuple[np.ndarray, dict[str, int], list[str]]:
    number = np.arange(values.size)
    came = values != MISSING
    came[-1] = True
    late = np.where(came & (values != MISSING), values, 30_000)
    sent = begin_ns + PERIOD_NS * number
    order = np.argsort((sent + late)[came], kind="stable")
    rows = np.stack([sent, sent + late, number], axis=1)[came][order]
    falls = int(np.count_nonzero(np.diff(rows[:, 2]) < 0))
    measured = int(np.count_nonzero(came))
    counts = {"asked": values.size, "measured": measured, "missing": values.size - measured, "out_of_order": falls}
    return rows, counts, ["publication_ns", "reception_ns", "seq"]


_ROWS = {"oneshot": _oneshot_rows, "cyclic": _cyclic_rows, "messages": _message_rows}


def clock_ns(when: datetime) -> int:
    return int((when - UNIX_0).total_seconds() * 1e9) % (10**15) + 10**9


def utc(when: datetime) -> str:
    return when.strftime("%Y-%m-%dT%H:%M:%SZ")


def npy(rows: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(rows, dtype="<i8"), version=(1, 0))
    return stream.getvalue()


def fill(folder: Path, files: dict[str, bytes], record: dict[str, Any]) -> None:
    known = {}
    for name, data in files.items():
        (folder / name).write_bytes(data)
        known[name] = {"size_bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    (folder / "run.json").write_text(json.dumps(record | {"files": known}, indent=2) + "\n")


def _unused(folder: Path, kind: str) -> Path:
    number = 1
    while (candidate := folder.with_name(f"{folder.name}.{kind}-{number}")).exists():
        number += 1
    return candidate
