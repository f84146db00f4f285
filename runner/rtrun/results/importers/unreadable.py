"""Files of known programs that hold no histogram, and how to measure so that `rtrun import` can read the result."""

import re
from dataclasses import dataclass

# Signs are searched for only near the beginning of a file.
_BEGINNING = 65_536

_HISTOGRAM = "Measure with a histogram: cyclictest -q -h 1000 > FILE, or cyclictest -q -h 1000 --json=FILE"
_TIMERLAT = "For latencies of timers measure with: rtla timerlat hist > FILE"
_MESSAGES = (
    "Wake-ups of a timer can be imported from: cyclictest -q -h 1000 > FILE."
    " For every message of one process to another measure with the suite communication_tests (rtrun quick)"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Unreadable:
    """One kind of file: `sign` matches a part of it, `lacks` is why it cannot be read, `advice` what to do instead."""

    program: str
    sign: re.Pattern[str]
    lacks: str
    advice: str

    def __str__(self) -> str:
        return f"it is from {self.program}, which {self.lacks}. {self.advice}"


def _sign(form: str) -> re.Pattern[str]:
    return re.compile(form, re.MULTILINE | re.ASCII)


def _json_of(programs: str) -> str:
    return rf'"cmdline:?": *"(?:[^"\s]*/)?(?:{programs})[\s"]'


KINDS = (
    Unreadable(
        program="cyclictest without -h",
        sign=_sign(
            r"^(?:\x1b\[[0-9]+A)?T: ?[0-9]+ \( *[0-9]+\) P: ?[0-9]+ I: ?[0-9]+ C: *[0-9]+ Min:"
            rf"|{_json_of('cyclictest')}"
        ),
        lacks="prints only min, avg and max",
        advice=_HISTOGRAM,
    ),
    Unreadable(
        program="signaltest",
        sign=_sign(rf"^T: ?[0-9]+ \( *[0-9]+\) P: ?[0-9]+ C: *[0-9]+ Min:|{_json_of('signaltest')}"),
        lacks="prints only min, avg and max",
        advice=_MESSAGES,
    ),
    Unreadable(
        program="pmqtest, ptsematest, sigwaittest or svsematest",
        sign=_sign(
            r"^#[0-9]+: ?ID[0-9]+, P[0-9]+, CPU[0-9]+, I[0-9]+; #[0-9]+: ?ID[0-9]+"
            rf"|{_json_of('pmqtest|ptsematest|sigwaittest|svsematest')}"
        ),
        lacks="prints only min, avg and max",
        advice=_MESSAGES,
    ),
    Unreadable(
        program="rtla timerlat top",
        sign=_sign(r"CPU COUNT +\| +cur +min +avg +max"),
        lacks="prints only cur, min, avg and max",
        advice="Measure with: rtla timerlat hist > FILE",
    ),
    Unreadable(
        program="rtla osnoise hist",
        sign=_sign(r"^# RTLA osnoise histogram"),
        lacks="counts how long the system interrupts a busy loop, not how late anything is",
        advice=_TIMERLAT,
    ),
    Unreadable(
        program="rtla osnoise top",
        sign=_sign(r"CPU Period +Runtime +Noise +% CPU Aval"),
        lacks="sums up how long the system interrupts a busy loop, not how late anything is",
        advice=_TIMERLAT,
    ),
    Unreadable(
        program="oslat",
        sign=_sign(rf"^oslat V [0-9.]+$|^Counter Freq:[ \t]+[0-9]+ \(Mhz\)|{_json_of('oslat')}"),
        lacks="counts the gaps of a busy loop, not how late anything is",
        advice=f"{_TIMERLAT}, or cyclictest -q -h 1000 > FILE",
    ),
    Unreadable(
        program="hwlatdetect",
        sign=_sign(r"^hwlatdetect: +test duration|^ts: [0-9.]+, inner:[0-9]+, outer:[0-9]+"),
        lacks="finds the gaps that hardware or firmware cause, not how late anything is",
        advice=(
            "To have it beside measurements, name hwlatdetect among the suites of a campaign. For latencies measure"
            " with: cyclictest -q -h 1000 > FILE"
        ),
    ),
    Unreadable(
        program="performance_test",
        sign=_sign(r'^---EXPERIMENT-START---|latency_mean \(ms\)|"latency_mean"'),
        lacks="writes only min, max, mean and variance of the messages of each second, in CSV and JSON alike",
        advice=(
            "For every message measure with the suite communication_tests, or observe the nodes of performance_test"
            " while they run: rtrun observe"
        ),
    ),
)


def recognise(text: str) -> Unreadable | None:
    """Return which program wrote a text that no importer reads; None where its beginning has no known sign."""
    beginning = text[:_BEGINNING]
    return next((kind for kind in KINDS if kind.sign.search(beginning)), None)
