"""A comparison as text for people, and as JSON for programs."""

import json
import math

from rtfiles.quantities import between, percent, rounded_down, rounded_up, signed, time
from rtrun.analysis.comparison.differences import Comparison, ComparisonAnswer, Ratio, Shift
from rtrun.judgement.compare import Compared
from rtrun.report.quantities import as_data
from rtrun.report.terminal import banner_of


def as_text(compared: Compared) -> str:
    """The answer for people."""
    lines = list(filter(None, [banner_of(compared.platform)]))
    for change in compared.changes:
        c = change.comparison
        lines.append(f"{c.answer}  {change.label}: {_why(c)}")
        seen = (("p99.9", change.p999_ns), ("max", change.max_ns))
        lines += [f"    {name:7} {time(pair[0])} -> {time(pair[1])}" for name, pair in seen]
        lines += [f"    {_shift(shift, c)}" for shift in c.shifts]
        if change.miss is None:
            lines.append("    no deadline was given for it: no P(miss)")
        else:
            lines.append(f"    P({change.miss}) {_ratio(change.misses, c.confidence)}")
        lines += [f"    assumes {text}" for text in c.assumes]
    lines += [f"not compared: {text}" for text in compared.ambiguous]
    lines += [f"only in A: {label}" for label in compared.only_a] + [f"only in B: {label}" for label in compared.only_b]
    lines += [f"not analysed: {text}" for text in compared.left_out]
    return "\n".join(lines) + "\n"


def _shift(shift: Shift, c: Comparison) -> str:
    """A shift with its interval; without one for few runs, as it would not include differences between runs."""
    text = f"{shift.figure:7} {time(shift.a_ns)} -> {time(shift.b_ns)}, "
    if c.units == "blocks":
        return f"{text}{signed(shift.shift_ns)} in these runs; an interval takes five runs a side"
    mark = "shifted" if shift.seen else "equal within the margin" if shift.within_margin else "not seen"
    if shift.seen and shift.within_margin:
        mark = "shifted, within the margin"
    return (
        f"{text}{100 * c.confidence:g} % CI of the shift {signed(shift.low_ns)} to {signed(shift.high_ns)}, "
        f"margin {time(shift.margin_ns)}: {mark}"
    )


def _why(c: Comparison) -> str:
    test = f"largest difference of the distributions {percent(c.distance)}, p = {c.p_value:.2g} ({c.units})"
    if c.answer == ComparisonAnswer.UNDECIDED:
        return f"{min(c.unit_counts)} {c.units} are too few to compare"
    if c.answer == ComparisonAnswer.RUNS_DIFFER:
        few = "fewer than five runs or boots a side" if c.units == "blocks" else ""
        apart = "" if c.interleaved else "not measured in turn: whatever else changed meanwhile is in it"
        return f"{'; '.join(filter(None, (few, apart)))}; {test}"
    if c.answer == ComparisonAnswer.NOT_SEEN:
        if c.units == "blocks":
            return f"{test}; fewer than five runs a side do not tell how large a shift is excluded"
        widest = max(c.shifts, key=lambda shift: max(-shift.low_ns, shift.high_ns) / shift.margin_ns)
        most = max(-widest.low_ns, widest.high_ns)
        return f"{test}; yet a shift of {widest.figure} of up to {time(most)} is not excluded"
    return test


def _ratio(ratio: Ratio | None, confidence: float) -> str:
    if ratio is None:
        return "cannot be compared: a histogram does not reach so far"
    if ratio.value is None:
        return "no miss on either side: nothing can be said of a change"
    interval = f"{100 * confidence:g} % CI"
    if math.isinf(ratio.value):
        return f"misses in B only: times {rounded_down(ratio.low)} at least ({interval})"
    if not ratio.value:
        return f"misses in A only: times {rounded_up(ratio.high)} at most ({interval})"
    ends = between(ratio.low, ratio.high) if math.isfinite(ratio.high) else f"{rounded_down(ratio.low)} at least"
    return f"times {ratio.value:.2g}, {interval} {ends}"


def as_json(compared: Compared) -> str:
    """The answer for programs; infinite ends are null, and so are intervals that too few runs do not allow."""
    data = as_data(compared)
    for change in data["changes"]:
        if change["comparison"]["units"] == "blocks":
            for shift in change["comparison"]["shifts"]:
                shift |= {"low_ns": None, "high_ns": None}
    return json.dumps({"schema": 2, **data}, indent=1, allow_nan=False) + "\n"
