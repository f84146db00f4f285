"""The campaigns of `rtrun quick`: all that a target has programs for in the time given, or a loop that runs there."""

from collections.abc import Mapping, Sequence
from typing import Any

from rtrun.kinds.loop import STREAM as LOOP
from rtrun.plan import suites
from rtrun.plan.conditions import SAMPLER
from rtrun.plan.middleware.description import NONE
from rtrun.plan.observation import ATTACHED, StreamDeadline

NAME = "quick"
BASELINE = "cyclictest"
PRIORITY = suites.options()["priority"].default
# A period of 1 ms: what cyclictest takes by default, and a usual rate of control loops.
PERIOD_US = 1000
# Shorter runs tell nothing about events that come once a second.
LEAST_S = 1
# The default middleware: the first of these for which a target has programs.
CHOICES = (("roscpp",), ("rcl",), ("futex", "unix", "tcp", "udp"))
# The kinds in the order in which they are measured: wake-ups first, messages last.
_ORDER = ("cyclic", "oneshot", "messages")


def measurable(programs: Mapping[str, str], middleware: str) -> list[str]:
    """The suites that a target can measure through a middleware, from the paths of its programs by name."""
    known = {name: suite for name, suite in suites.suites().suites.items() if suite.kind in _ORDER}
    found = [
        name
        for name, suite in known.items()
        if all(suites.executable(name, program, {"middleware": middleware}) in programs for program in suite.programs)
    ]
    return sorted(found, key=lambda name: _ORDER.index(str(known[name].kind)))


def middlewares(programs: Mapping[str, str]) -> tuple[str, ...]:
    """The middlewares through which a target is measured if none is named; the first choice if it has no programs."""
    found = (tuple(name for name in choice if measurable(programs, name)) for choice in CHOICES)
    return next(filter(None, found), CHOICES[0])


def campaign(
    names: Sequence[str], *, middlewares: Sequence[str], policy: str, duration_s: float, traced_above_ns: int | None
) -> dict[str, Any]:
    """A campaign, in the form of its file, of these suites and baselines, each for its part of the time.

    With `traced_above_ns` the first suite is measured once more, with the kernel's trace of values above that limit.
    """
    traced = next((name for name in names if traced_above_ns is not None and name != BASELINE), None)
    through = {name: [] if suites.suite(name).middleware == NONE else list(middlewares) for name in names}
    parts = sum(max(1, len(through[name])) for name in [*names, *([traced] if traced else [])])
    runs = [_run(name, through[name], duration_s / parts) for name in names]
    if traced is not None and traced_above_ns is not None:
        runs[names.index(traced)]["trace"] = {"above": f"{max(1, traced_above_ns // 1000)}us"}
    return {"schema": 1, "name": NAME, "common": {"policy": policy}, "runs": runs}


def observing(loop: str, *, deadline_ns: int | None, for_ns: int, is_traced: bool) -> dict[str, Any]:
    """A campaign, in the form of its file, that observes the loop of a program, or PROGRAM/THREAD, that runs already.

    With `is_traced` and a deadline it is observed for half of the time without, then with the kernel's trace of late
    values.
    """
    deadlines = [] if deadline_ns is None else [StreamDeadline(kind=LOOP.word, name=loop, deadline_ns=deadline_ns).text]
    traced = {"trace": {"above": f"{max(1, deadline_ns // 1000)}us"}} if is_traced and deadline_ns is not None else {}
    return {
        "schema": 1,
        "name": NAME,
        "subject": ATTACHED,
        "for": f"{for_ns // (2 if traced else 1)}ns",
        "loops": [loop],
        "deadlines": deadlines,
        "runs": [{SAMPLER: "none"} | traced],
    }


def _run(name: str, middlewares: list[str], share_s: float) -> dict[str, Any]:
    described = suites.suite(name)
    repetitions = max(LEAST_S, share_s) * 1_000_000 // PERIOD_US
    run: dict[str, Any] = {"suite": name, "repetitions": int(repetitions)}
    for key, value in (("frequency_hz", 1_000_000 // PERIOD_US), ("timeout_us", PERIOD_US), ("interval_us", PERIOD_US)):
        if key in described.parameters:
            run[key] = value
    if middlewares:
        run["middleware"] = middlewares if len(middlewares) > 1 else middlewares[0]
    return run
