"""A user who measures a machine and asks the command line: round by round, with attempts that fail, copies and looks.

The command line is called as a function in this process; nothing of it is gone around.
"""

import contextlib
import io
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from drawn.files import PERIOD_NS, Attempt, Results
from drawn.hazards import named_in
from drawn.machine import Machine, Slot

from rtrun.cli import main
from rtrun.plan.goal import Goal
from rtrun.results.goal_file import write_goal

TRIES = 4
LOOKS = 6
_HISTOGRAM_US = 10_000


def call(*argv: str) -> tuple[int, str, str]:
    """Call ``rtrun``: its exit status, what it printed, and what it said on standard error."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)]
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
        status = main(argv)
    out, err = (stream.buffer.getvalue().decode() for stream in streams)  # type: ignore[attr-defined]
    return status, out, err


class User:
    """One user with one machine, who works in a folder that is there for nothing else."""

    def __init__(self, machine: Machine, folder: Path) -> None:
        self.machine, self.plan = machine, machine.plan
        self.rng = np.random.default_rng([machine.seed, 1])
        self.folder = folder / "results"
        self.beside = folder
        boards = [f"b{number}" for number in range(self.plan.boards)]
        self.results = Results(folder=self.folder, suite=self.plan.suite, boards=boards, digest=f"{machine.seed:016x}")
        self.has_goal = bool(self.rng.random() < 0.6)
        self.question = ["--deadline", "400us", "--probability", f"{self.plan.probability:g}"]
        self.attempts = self.failed = 0

    def measure_and_ask(self) -> dict[str, Any]:
        """Measure all runs; ask at the end, or after each round until it is green."""
        self._begin()
        slots = self.machine.slots
        looks = {len(slots) - 1}
        if self.plan.looks:
            looks |= {int(at) for at in np.linspace(1, len(slots) - 1, LOOKS)}
        answer: dict[str, Any] = {}
        for slot in slots:
            self._measure(slot)
            if slot.number in looks:
                if self.plan.suite != "histograms":
                    self.results.commit()
                if slot.number == len(slots) - 1:
                    self._copy()
                answer = self.ask()
                # A campaign with a goal ends with either answer, who has none goes on until it is green.
                if answer["passed"] or (answer["refuted"] and self.has_goal):
                    break
        return answer | {"runs": slot.number + 1, "failed": self.failed}

    def _begin(self) -> None:
        if self.plan.suite == "histograms":
            self.beside.mkdir(parents=True, exist_ok=True)
            return
        self.results.begin(None)
        if self.has_goal:
            goal: dict[str, Any] = {
                "deadline": "400us",
                "probability": f"{self.plan.probability:g}",
                "at_most": "8h",
                "boots": self._boots_asked(),
            }
            if self.plan.base == "bursts" and self.rng.random() < 0.25:
                goal["bursts"] = int(self.plan.burst)
            write_goal(self.folder, Goal.model_validate(goal))
        self.results.session(self.machine.slots[0].start)

    def _boots_asked(self) -> int:
        """At most as many as are measured, or nothing would ever be proven; more only where nobody knows how many."""
        least = 5 if not self.plan.is_boot_known else min(5, self.plan.boots)
        return int(self.rng.choice([1, least, self.plan.boots]))

    def _name(self, slot: Slot) -> str:
        suite = {"oneshot": "oneshot_timer_tests", "cyclic": "cyclic_timer_tests", "messages": "communication_tests"}
        stem = f"-{suite[self.plan.suite]}-tnRTFIFO" if self.plan.suite in suite else ""
        if not self.has_goal:
            return f"{slot.number + 1:03}{stem}"
        return f"001{stem}" + (f"-r{slot.number + 1}" if slot.number else "")

    def _boot(self, slot: Slot) -> str | None:
        if not self.plan.is_boot_known:
            return None
        return f"{self.machine.seed:08x}-0000-4000-8000-{slot.board:04x}{slot.boot:08x}"

    def _measure(self, slot: Slot) -> None:
        """Measure a run, again while it fails."""
        failing = self.plan.failing
        for number in range(TRIES):
            outputs, is_bad, load = self.machine.new_attempt(slot)
            attempt = self._attempt(slot, outputs, load)
            fails = failing and self.rng.random() < (failing.of_bad if is_bad else failing.of_good)
            if not failing or not fails:
                self._close(attempt)
                return
            if self._fail(attempt, failing.how):
                return
            slot = replace(slot, start=slot.start + timedelta(seconds=20))
            if failing.how == "incomplete":
                # The board has restarted.
                slot = replace(slot, boot=slot.boot + 1000 * (number + 1))

    def _fail(self, attempt: Attempt, how: str) -> bool:
        """End an attempt badly; whether nobody measures it again."""
        self.failed += 1
        attempt.status, attempt.exit_status = "failed", 137
        attempt.kept = int(self.rng.integers(1, attempt.loops))
        name = self.results.record(attempt)["programs"][-1]["name"]
        reasons = [f"{name} ended with exit status 137", f"{name} was ended: it took longer than it may"]
        attempt.reason = str(self.rng.choice(reasons))
        if how == "invalid":
            attempt.status, attempt.exit_status, attempt.kept = "invalid", 0, None
            attempt.achieved_hz = round(1e9 / PERIOD_NS * float(self.rng.uniform(0.8, 0.97)), 3)
            attempt.reason = f"the publisher missed its rate: asked for 1000 Hz, achieved {attempt.achieved_hz:g} Hz"
        if how == "incomplete":
            attempt.status = "ok"
            self.results.cut_off(attempt, "the target was restarted while nobody looked")
            return False
        folder = self.results.close(attempt)
        if how in ("deleted", "missing"):
            shutil.rmtree(folder)
        return how == "missing"

    def _attempt(self, slot: Slot, outputs: Sequence[np.ndarray], load: np.ndarray | None) -> Attempt:
        self.attempts += 1
        gaps: list[tuple[int, int]] = []
        unseen = None
        if load is not None:
            edges = np.flatnonzero(np.diff(np.r_[False, load, False].astype(int)))
            unseen = np.zeros(slot.loops, bool)
            for begin, end in edges.reshape(-1, 2):
                first = int(end - round((end - begin) * self.plan.gaps))
                if first < end and not (first <= 1 and end >= slot.loops - 1):
                    unseen[first:end] = True
                    gaps.append((first * PERIOD_NS, int(end) * PERIOD_NS))
            if slot.loops - np.count_nonzero(unseen) < 10:
                gaps, unseen = [], None
        return Attempt(
            run=self._name(slot),
            repeat=slot.number + 1,
            board=f"b{slot.board}",
            boot=self._boot(slot),
            start=slot.start,
            outputs=list(outputs),
            gaps=gaps,
            unseen=unseen,
            uid=f"{self.machine.seed:08x}{self.attempts:08x}",
        )

    def _close(self, attempt: Attempt) -> None:
        if self.plan.suite != "histograms":
            self.results.close(attempt)
            return
        path = self.beside / f"{attempt.run}.txt"
        path.write_text(_histogram(attempt.outputs))
        self._import(path, attempt)
        for number in range(self.plan.copies):
            again = self.beside / f"{attempt.run}-again-{number}.txt"
            if self.machine.seed % 2:
                again.write_bytes(path.read_bytes())
                self._import(again, attempt)
            else:
                shutil.copytree(self.folder / attempt.run, self.folder / again.stem)

    def _import(self, path: Path, attempt: Attempt) -> None:
        words = ["import", str(path), "--results", str(self.folder), "--platform", "hardware", "--quiet"]
        words += ["--board", attempt.board, "--kernel", "6.1.0-rt", "--start", attempt.start.isoformat()]
        status, _, err = call(*words, *(["--boot", attempt.boot] if attempt.boot else []))
        if status:
            raise AssertionError(f"{' '.join(words)}: {err}")

    def _copy(self) -> None:
        """Copy run directories, as somebody does who puts folders together."""
        if not self.plan.copies or self.plan.suite == "histograms":
            return
        for folder in sorted(self.folder.glob("[0-9]*"))[: self.plan.copies]:
            shutil.copytree(folder, folder.with_name(f"{folder.name}-copy"))

    def ask(self) -> dict[str, Any]:
        """What the gate answers: passed or not; whether it refutes; the hazards that it names with a number."""
        words = ["gate", str(self.folder), "--json"]
        if self.plan.suite == "histograms" or not self.has_goal:
            words += self.question
        # Who says that values are independent which are not is wrong, whatever the answer.
        if self.plan.suite == "histograms" and self.plan.is_independent and self.machine.seed % 3:
            words.append("--assume-independent")
        status, out, err = call(*words)
        if status not in (0, 1):
            # Where every run was deleted nothing is there to judge.
            error = {} if "no finished run" in err else {"error": err.strip()[-300:]}
            return {"status": status, "passed": False, "refuted": False, "said": [], **error}
        cases = json.loads(out)["cases"]
        refuted = self._refuted(cases)
        judged = cases if status == 0 else refuted
        text = "\n".join(_flat(case) for case in judged)
        return {
            "status": status,
            "passed": status == 0,
            "refuted": bool(refuted),
            "said": named_in(text),
            "n": _n(cases),
        }

    def _refuted(self, cases: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """The cases that refute what is asked: of all boards together, else of one of them if that one is no worse."""
        if self.plan.boards == 1:
            return [case for case in cases if case["answer"] == "REFUTED"]
        together = [case for case in cases if case["about"].endswith(" boards")]
        if together:
            return [case for case in together if case["answer"] == "REFUTED"]
        single = [case for case in cases if case["about"].endswith("b0") and case["answer"] == "REFUTED"]
        return single if single and self.machine.truth_of_board(0) <= self.plan.probability else []


def _flat(value: Any) -> str:
    """All words of an answer."""
    if isinstance(value, dict):
        return "\n".join(_flat(each) for key, each in value.items() if key not in ("about", "n", "misses", "worst_ns"))
    if isinstance(value, list):
        return "\n".join(map(_flat, value))
    return "" if value is None or isinstance(value, bool) else str(value)


def _n(cases: Sequence[dict[str, Any]]) -> int:
    return max((case["n"] for case in cases if isinstance(case.get("n"), int)), default=0)


def _histogram(threads: Sequence[np.ndarray]) -> str:
    """What cyclictest 2.10 prints with a histogram in whole microseconds, without rows of nothing."""
    values = [np.minimum(each // 1000, _HISTOGRAM_US - 1) for each in threads]
    counts = np.stack([np.bincount(each, minlength=_HISTOGRAM_US) for each in values], axis=1)
    rows = [f"{us:06} " + "\t".join(f"{count:06}" for count in row) for us, row in enumerate(counts) if row.any()]
    tail = {
        "Min Latencies": [f"{each.min():05}" for each in values],
        "Avg Latencies": [f"{int(each.mean()):05}" for each in values],
        "Max Latencies": [f"{each.max():05}" for each in values],
        "Histogram Overflows": ["00000"] * len(values),
    }
    lines = ["# /dev/cpu_dma_latency set to 0us", "# Histogram", *rows]
    lines += [f"# {name}: {' '.join(numbers)}" for name, numbers in tail.items()]
    lines += ["# Histogram Overflow at cycle number:", *(f"# Thread {number}:" for number in range(len(values)))]
    return "\n".join(lines) + "\n"


def show(machine: Machine, folder: Path) -> None:
    """Print what the command line prints about the results in a folder."""
    for command in ("verdict", "gate"):
        status, out, err = call(
            command, str(folder / "results"), "--deadline", "400us", "--probability", f"{machine.plan.probability:g}"
        )
        sys.stdout.write(f"rtrun {command}: {status}\n{out}{err}")
