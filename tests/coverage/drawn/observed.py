"""A timer that is observed, with gaps: a run of the observation, and one of its stream."""

import json
from typing import Any

import numpy as np
from drawn.files import DEADLINE_NS, PERIOD_NS, Attempt, clock_ns, npy, program_json

_PARAMETERS = {"node": "/control", "period_ns": PERIOD_NS}
_GRAPH = {"schema": 1, "placed": [], "refused": [], "remarks": [], "hazards": []}
FILES = {"graph.json": json.dumps(_GRAPH).encode()}
# What the two records have in common, unlike one of a suite that was started.
SHARED: dict[str, Any] = {
    "subject": "attached",
    "parameters": {},
    "programs": [],
    "requested": {},
    "in_effect": {"observations": 2},
    "outputs": [],
}


def stream_of(attempt: Attempt) -> str:
    """The name of the run of the stream."""
    return f"{attempt.run}-timers-control-1000000"


def whole_record(attempt: Attempt) -> dict[str, Any]:
    """What the record of the observation has of its own."""
    return {"suite": "observation", **_coverage(attempt)}


def stream_record(attempt: Attempt) -> dict[str, Any]:
    """What the record of the stream has of its own."""
    return {
        "run": stream_of(attempt),
        "attempt": "",
        "suite": "observed_timers",
        "parameters": _PARAMETERS,
        "observed_by": attempt.run,
        "deadline_ns": DEADLINE_NS,
        "outputs": [stream_of(attempt)],
        **_coverage(attempt),
    }


def stream_files(attempt: Attempt) -> dict[str, bytes]:
    """Rows of what was seen; those without a gap between them have one segment."""
    values = attempt.outputs[0]
    is_seen = np.ones(values.size, bool) if attempt.unseen is None else ~attempt.unseen
    begins = np.diff(np.r_[False, is_seen].astype(int)) == 1
    segment = np.cumsum(begins)[is_seen] - 1
    due = (clock_ns(attempt.start) + PERIOD_NS * np.arange(values.size))[is_seen]
    real = np.maximum.accumulate(due + values[is_seen])
    rows = np.stack([real, due, due + values[is_seen], segment], axis=1)
    measured = int(np.count_nonzero(np.diff(segment) == 0))
    name = stream_of(attempt)
    columns = ["timestamp_ns", "expected_ns", "real_ns", "segment"]
    counts = {"asked": measured, "measured": measured}
    record = program_json(attempt, "observed_timers", _PARAMETERS, counts, columns, name) | {"middleware": ""}
    return {f"{name}.npy": npy(rows), f"{name}.json": json.dumps(record).encode()}


def _coverage(attempt: Attempt) -> dict[str, Any]:
    begin, asked = clock_ns(attempt.start), attempt.loops * PERIOD_NS
    missed = sum(end - start for start, end in attempt.gaps)
    gaps = [{"begin_ns": begin + start, "end_ns": begin + end, "cause": "rested"} for start, end in attempt.gaps]
    words = (
        f"{(asked - missed) / 1e9:.3g} s of {asked / 1e9:.3g} s were seen, with {len(gaps)} gaps: "
        f"rested {missed / 1e9:.3g} s"
    )
    return {
        "coverage": {"begin_ns": begin, "asked_ns": asked, "seen_ns": asked - missed, "gaps": gaps},
        "reason": words if gaps else None,
    }
