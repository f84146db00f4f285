"""Windows before an outlier, as long as it, in which nothing was late: who had each CPU, and for how long."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rtrun.causes.events import Event
from rtrun.causes.timeline import Timeline

WINDOWS_MAX = 200  #: windows before an outlier that are compared with it
# Windows are searched for in this much time, and further back until there are this many.
CONTROL_NS, WINDOWS_WANTED = 50_000_000, 20


@dataclass(frozen=True, kw_only=True, slots=True)
class Windows:
    """Windows of one length: for each CPU and window the nanoseconds of each thread, interrupt or softirq by name."""

    count: int = 0
    times_ns: Mapping[int, Sequence[Mapping[str, int]]] = field(default_factory=dict)

    def mean_ns(self, cpu: int | None, name: str) -> int:
        """The mean time per window that a thread or interrupt of this name had a CPU."""
        times = self.times_ns.get(-1 if cpu is None else cpu, ())
        return sum(window.get(name, 0) for window in times) // self.count if self.count else 0

    def with_at_least(self, cpu: int | None, name: str, least_ns: int) -> int:
        """The number of windows in which a thread or interrupt of this name had a CPU for at least `least_ns`."""
        times = self.times_ns.get(-1 if cpu is None else cpu, ())
        return sum(window.get(name, 0) >= max(1, least_ns) for window in times)


def control_ns(length_ns: int) -> int:
    """How far back from an outlier windows of a length are searched."""
    return max(min(WINDOWS_MAX * length_ns, CONTROL_NS), WINDOWS_WANTED * length_ns)


def windows_before(
    timeline: Timeline, events: Sequence[Event], *, begin_ns: int, length_ns: int, late: Sequence[tuple[int, int]]
) -> Windows:
    """At most `WINDOWS_MAX` windows of a length that end at `begin_ns` or before.

    Windows that overlap one of `late` are left out, and windows without any event: recording was paused.
    """
    times: dict[int, list[Mapping[str, int]]] = {cpu: [] for cpu in timeline.cpus}
    count, end_ns = 0, begin_ns
    while count < WINDOWS_MAX and length_ns > 0 and end_ns - length_ns >= timeline.begin_ns:
        start_ns, stop_ns = end_ns - length_ns, end_ns
        end_ns = start_ns
        place = bisect_left(events, (start_ns,))
        if place == len(events):
            continue
        if events[place].at_ns >= stop_ns:
            # Nothing was recorded here: continue at the last event before.
            if place == 0:
                break
            end_ns = min(end_ns, events[place - 1].at_ns + 1)
            continue
        if any(start_ns < at_ns and due_ns < stop_ns for due_ns, at_ns in late):
            continue
        count += 1
        for cpu, windows in times.items():
            window: dict[str, int] = {}
            for span_begin_ns, span_end_ns, who in timeline.spans(cpu, start_ns, stop_ns):
                if who is not None:
                    window[who.name] = window.get(who.name, 0) + span_end_ns - span_begin_ns
            windows.append(window)
    return Windows(count=count, times_ns=times)
