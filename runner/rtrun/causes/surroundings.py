"""What else was unusual on the target when the highest values came: compares a run with its sampler's record."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtrun.analysis.order.coincidence import LEAST_INTERVALS, Floats, find_coincidences
from rtrun.causes.measured import Measured, read_measured
from rtrun.kinds.lateness import Measure
from rtrun.kinds.values import Int64s
from rtrun.results.record import RunRecord, check_file
from rtrun.results.target_states import read_states
from rtrun.validity.observations import COUNTS_MAX, SAMPLER_OUTPUT, Observation, observations_of

# The ticks in the first line of /proc/stat, by their place (proc(5)).
_TICKS = {
    0: "user time", 1: "time at low priority", 2: "kernel time", 4: "waiting for disks",
    5: "time in interrupts", 6: "time in softirqs", 7: "time stolen by the host",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Unusual:
    """A quantity that was unusual when the highest values of an output came.

    `late` and `otherwise` are medians in `unit`. `p_value` holds for all `tried` quantities together.
    """

    run: str
    output: str
    quantity: str
    unit: str
    late: float
    otherwise: float
    p_value: float
    tried: int


def find_unusual(folder: Path, record: RunRecord, measure: Measure | None = None) -> Iterator[Unusual]:
    """Yield what was unusual around the highest values of a run; `measure` is that of `read_measured`.

    Raises UsageError for files that are not what they should be.
    """
    if SAMPLER_OUTPUT not in record.files:
        return
    check_file(folder, record, SAMPLER_OUTPUT)
    observations = observations_of(folder)
    bounds_s = _bounds_s(folder, record)
    for measured in read_measured(folder, record, measure):
        within, highest = _intervals(observations, measured, bounds_s)
        if len(within) <= LEAST_INTERVALS:
            continue
        known = {key: row for key, row in _quantities(within).items() if np.ptp(row) > 0}
        for coincidence in find_coincidences(np.array(list(known.values())), highest):
            quantity, unit = list(known)[coincidence.row]
            yield Unusual(
                run=record.run,
                output=measured.output,
                quantity=quantity,
                unit=unit,
                late=coincidence.late,
                otherwise=coincidence.otherwise,
                p_value=coincidence.p_value,
                tried=len(known),
            )


def _bounds_s(folder: Path, record: RunRecord) -> tuple[float, float] | None:
    """The uptimes before and after the run; None if they are not known."""
    states = read_states(folder, record)
    if states is None:
        return None
    before_s, after_s = states.before.uptime, states.after.uptime
    return None if before_s is None or after_s is None else (before_s, after_s)


def _intervals(
    observations: Sequence[Observation], measured: Measured, bounds_s: tuple[float, float] | None
) -> tuple[list[Observation], Floats]:
    """The observations from the first value to the last, and the highest value between each and the next.

    Observations have uptimes, samples the time of a clock that NTP does not discipline. The difference of the two
    clocks is assumed to be 0, or as near to 0 as the times before and after the run allow.
    """
    first_s, last_s = float(measured.times_ns.min()) / 1e9, float(measured.times_ns.max()) / 1e9
    offset_s = 0.0
    if bounds_s is not None:
        offset_s = min(max(0.0, last_s - bounds_s[1]), max(first_s - bounds_s[0], last_s - bounds_s[1]))
    times_s = [sample.uptime_s + offset_s for sample in observations]
    places = [place for place, at_s in enumerate(times_s) if first_s <= at_s <= last_s]
    within = [observations[place] for place in places]
    edges_ns = (np.array([times_s[place] for place in places]) * 1e9).astype(np.int64)
    if edges_ns.size < 2 or np.any(np.diff(edges_ns) <= 0):
        return [], np.array([])
    return within, _highest(measured, edges_ns)


def _highest(measured: Measured, edges_ns: Int64s) -> Floats:
    interval = np.searchsorted(edges_ns, measured.times_ns, side="right") - 1
    inside = (interval >= 0) & (interval < edges_ns.size - 1)
    highest = np.full(edges_ns.size - 1, -np.inf)
    np.maximum.at(highest, interval[inside], measured.values_ns[inside])
    return highest


def _quantities(within: Sequence[Observation]) -> Mapping[tuple[str, str], Floats]:
    """Every quantity of the intervals between observations, by name and unit: counts per second, means of gauges."""
    lengths_s = np.diff([sample.uptime_s for sample in within])
    quantities: dict[tuple[str, str], Floats] = {}
    ticks = np.diff(np.array([sample.ticks_by_kind for sample in within], dtype=np.float64), axis=0)
    all_ticks = np.maximum(ticks.sum(axis=1), 1)
    for place, name in _TICKS.items():
        quantities[name, "% of all CPUs"] = 100 * ticks[:, place] / all_ticks
    gauges = (
        ("highest temperature", "C", [max(sample.temperature_mc, default=0) / 1000 for sample in within]),
        ("lowest CPU frequency", "MHz", [min(sample.frequency_khz, default=0) / 1000 for sample in within]),
    )
    for name, unit, values in gauges:
        quantities[name, unit] = (np.array(values[:-1]) + np.array(values[1:])) / 2
    for number, sample in enumerate(within[1:]):
        for name, count in re.findall(r"([^ =]+)=(\d+)", sample.counts):
            if (name, "a second") not in quantities and len(quantities) < COUNTS_MAX:
                quantities[name, "a second"] = np.zeros(lengths_s.size)
            if (name, "a second") in quantities:
                quantities[name, "a second"][number] = int(count) / lengths_s[number]
    return quantities
