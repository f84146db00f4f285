"""Checks of what a probe read from a timer's own members, before it is passed on.

The members are not part of any interface: a release that is not known here may have others there. The time at which the
timer was due is passed on if it is whole periods after that of the call before. A period is passed on once due times
have confirmed it: a pointer that is taken for nanoseconds is a period of a day.
"""

from collections.abc import Hashable

_PERIOD_MAX_NS = 7 * 24 * 3600 * 10**9
_TIMERS_MAX = 10_000  #: timers of observed programs that are kept in memory


class TimerChecks:
    """The timers whose calls were seen, by an identity of each."""

    def __init__(self) -> None:
        self._before: dict[Hashable, tuple[int, int, bool]] = {}
        """Period and time of the latest call, and whether such times have shown that period."""

    def check(self, timer: Hashable, values: dict[str, int | str]) -> None:
        """Remove from the values of a call what cannot be trusted: `expected_ns`, `period_ns` and `clock`."""
        period_ns, expected_ns = values.get("period_ns"), values.get("expected_ns")
        if not isinstance(period_ns, int) or not 0 < period_ns <= _PERIOD_MAX_NS:
            for name in ("period_ns", "expected_ns", "clock"):
                values.pop(name, None)
            self._before.pop(timer, None)
            return
        before = self._before.get(timer)
        if before is None and len(self._before) >= _TIMERS_MAX:
            self._before.clear()
        is_same = before is not None and before[0] == period_ns
        is_shown = is_same and before is not None and before[2]
        # Its first call, or the first after it was set again: there is nothing to compare with.
        step_ns = expected_ns - before[1] if isinstance(expected_ns, int) and before is not None and is_same else 0
        if step_ns <= 0 or step_ns % period_ns:
            values.pop("expected_ns", None)
        else:
            is_shown = True
        if isinstance(expected_ns, int):
            self._before[timer] = (period_ns, expected_ns, is_shown)
        if not is_shown:
            del values["period_ns"]
