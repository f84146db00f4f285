"""Campaigns in which nothing has an effect: what the claims of the thesis make of them is decided by chance alone."""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from rtrun.judgement.study import study
from rtrun.thesis.examination import Finding
from rtrun.thesis.examiners import examine_claims

# At the end: nothing there may stand in for a module of this folder.
sys.path.append(str(Path(__file__).parents[1] / "rtrun"))
from report.campaigns import communication_rows, cyclic_rows, oneshot_rows, write_run

# Claims that something makes a difference, or none, and whichever answer would be wrong where nothing does. A claim
# that names the size of its effect is refuted with right.
WRONG = {
    "oneshot-latency-grows-with-timeout": (Finding.CONFIRMED,),
    "cyclic-degrades-above-1khz": (Finding.CONFIRMED, Finding.REFUTED),
    "default-priority-unpredictable": (Finding.CONFIRMED,),
    "comm-more-subscribers-broader": (Finding.CONFIRMED, Finding.REFUTED),
    "comm-higher-frequency-faster": (Finding.CONFIRMED, Finding.REFUTED),
    "peaks-random": (Finding.REFUTED,),
    "rr-equals-fifo": (Finding.REFUTED,),
}
_TEN: list[tuple[str, dict[str, Any]]] = [
    *(
        ("oneshot_timer_tests", {"policy": policy, "timeout_us": timeout_us, "busy_mode": 0})
        for policy, timeout_us in (("RR", 1000), ("RR", 10_000), ("FIFO", 1000), ("0", 1000))
    ),
    *(
        ("cyclic_timer_tests", {"policy": policy, "frequency_hz": frequency_hz})
        for policy, frequency_hz in (("RR", 1000), ("RR", 2000), ("FIFO", 1000))
    ),
    *(
        ("communication_tests", {"policy": "RR", "frequency_hz": hz, "payload_bytes": 0, "subscribers": subscribers})
        for hz, subscribers in ((100, 1), (1000, 1), (100, 5))
    ),
]


def outputs_of(suite: str, parameters: dict[str, Any], values: np.ndarray) -> list[np.ndarray]:
    """The rows of each output of a run."""
    if suite == "oneshot_timer_tests":
        return [oneshot_rows(values, parameters["timeout_us"])]
    if suite == "cyclic_timer_tests":
        return [cyclic_rows(values, parameters["frequency_hz"])]
    return [communication_rows(values, parameters["frequency_hz"]) for _ in range(parameters["subscribers"])]


def decided(rng: np.random.Generator) -> list[str]:
    """What is decided wrongly after five runs each of ten groups in turn; runs differ by 1 us (standard deviation)."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number in range(50):
            suite, parameters = _TEN[number % 10]
            values = (1000 * (86 + rng.normal() + rng.gamma(4.0, 4.0, 1000))).astype(np.int64)
            start = f"2026-01-01T00:{number:02}:00+00:00"
            outputs = outputs_of(suite, parameters, values)
            times = {"start_time": start, "end_time": start}
            write_run(root, f"{number:02}", suite, outputs, parameters, asked=1000, logs=False, **times)
        examined = {one.id: one.result.finding for one in examine_claims(study(root, bounds=False))}
    return [claim for claim, wrong in WRONG.items() if examined[claim] in wrong]


def write_sent(root: Path, name: str, values: np.ndarray, *, is_kept: bool) -> None:
    """A run of publish-subscribe, whose publisher kept its rate, or missed it by a fifth."""
    rate = {"asked_hz": 1000, "achieved_hz": 1000.0 if is_kept else 800.0, "overruns": 0, "skipped": 0}
    programs = [{"name": "communication_tests_publisher", "argv": [], "exit_status": 0, "rate": rate}]
    parameters = {"policy": "RR", "frequency_hz": 1000, "payload_bytes": 0, "subscribers": 1}
    record = {"programs": programs, "status": "ok" if is_kept else "invalid", "attempt": name}
    rows = [communication_rows(values, 1000)]
    write_run(root, name, "communication_tests", rows, parameters, asked=values.size, logs=False, **record)
