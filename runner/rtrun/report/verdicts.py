"""A verdict in words: the answer, and the numbers that it rests on."""

import math
from dataclasses import dataclass

from rtfiles.output import printable
from rtrun.analysis.deadline import Answer, Verdict
from rtrun.report.boards import spread
from rtrun.report.claims.examination import us
from rtrun.report.groups import Group
from rtrun.report.tables import grouped

# Fewer boots say too little of how boots differ: Student's t widens by more than twice (docs/analysis.md).
ENOUGH_BOOTS = 5
# In this order a reader has to see the answers.
WORST_FIRST = (Answer.REFUTED, Answer.NEEDS_MORE, Answer.IF_INDEPENDENT, Answer.PROVEN, Answer.NO_STATEMENT)


def severity(answer: str, worst_ns: int | None) -> tuple[int, float]:
    """Sorts scenarios: the worst answer first, and within an answer the highest value first."""
    return WORST_FIRST.index(Answer(answer)), math.inf if worst_ns is None else -worst_ns


@dataclass(frozen=True, kw_only=True)
class Line:
    """A verdict: its answer, what it is about, and the numbers."""

    answer: str
    about: str
    text: str


def verdict_line(group: Group, name: str = "") -> Line:
    """The verdict of a group in one line; `name` is what it is called, its label where none is given."""
    verdict, about = group.verdict, printable(name or group.label)
    if verdict is None:
        return Line(answer=Answer.NEEDS_MORE, about=about, text=group.undecidable or "nothing was measured")
    return Line(answer=verdict.answer, about=about, text=_numbers(verdict, group))


def _numbers(verdict: Verdict, group: Group) -> str:
    parts = [f"{grouped(verdict.late)} of {grouped(verdict.n)} late"]
    if verdict.absent:
        parts[0] += f" and {verdict.absent} never came"
    parts.append(f"P(miss) {_between(verdict)}")
    if verdict.worst_ns is not None:
        parts.append(f"worst {us(verdict.worst_ns)} us")
    if verdict.design_effect > 1.005:
        parts.append(f"dependent values: worth {grouped(verdict.n_effective)} independent measurements")
    if verdict.refused:
        parts.insert(0, verdict.refused)
    elif verdict.change is not None:
        change = f"it did not stay the same: {verdict.change.text} (p = {verdict.change.p_value:.1g})"
        parts.insert(0 if verdict.answer == Answer.NEEDS_MORE else len(parts), change)
    if verdict.answer == Answer.NEEDS_MORE:
        parts += _more(verdict)
    elif verdict.answer in (Answer.PROVEN, Answer.IF_INDEPENDENT):
        parts += _scope(verdict)
    startup_ns = [value.value_ns for one in group.digests for value in one.header.startup]
    late_start = [value_ns for value_ns in startup_ns if value_ns > verdict.deadline_ns]
    if late_start:
        parts.append(f"start-up apart: {len(late_start)} late, worst {us(max(late_start))} us")
    if group.members:
        parts.append(f"of single boards: {spread(group)}")
    parts += [f"assumes {text}" for text in verdict.assumes]
    return "; ".join(parts)


def _between(verdict: Verdict) -> str:
    if verdict.lower == 0:
        return f"at most {verdict.upper:.2g}"
    return f"{verdict.lower:.2g} to {verdict.upper:.2g}"


def _scope(verdict: Verdict) -> list[str]:
    """What a proof holds for: bursts and boots."""
    covered = f"holds for bursts of up to {verdict.longest_burst:.0f} misses"
    more = [f"{_amount(verdict, count)} for bursts of {length}" for length, count in verdict.further_for_bursts]
    return [covered + (f" (without a miss, {', '.join(more)})" if more else ""), *_boots(verdict)]


def _boots(verdict: Verdict) -> list[str]:
    if verdict.boards > 1:
        few = f"; for boards of this kind measure on {ENOUGH_BOOTS} or more"
        return [f"holds for the {verdict.boards} boards together{few if verdict.boards < ENOUGH_BOOTS else ''}"]
    if verdict.boots is None:
        return []
    if verdict.boots == 1:
        return [f"holds for the boot that was measured; for the system measure on {ENOUGH_BOOTS} boots or more"]
    return [f"{verdict.boots} boots"] if verdict.boots >= ENOUGH_BOOTS else [f"{verdict.boots} boots only"]


def _more(verdict: Verdict) -> list[str]:
    parts = _boots(verdict)
    if verdict.change is not None:
        return parts
    if verdict.further is not None:
        parts.append(
            f"{_amount(verdict, verdict.further)} prove it without {'another' if verdict.misses else 'a'} miss"
            + (", if dependence stays as seen" if verdict.design_effect > 1.005 else "")
        )
    if verdict.further_likely is not None:
        answer, count = verdict.further_likely
        parts.append(f"at the rate seen, {answer} after {_amount(verdict, count)} nine times in ten")
    elif verdict.misses:
        parts.append("at the rate seen, no number is likely to decide it")
    return parts


def _amount(verdict: Verdict, count: int) -> str:
    hours = verdict.hours(count)
    return f"{grouped(count)} more measurements" + (
        "" if hours is None else f" ({hours:.2g} h)" if hours < 10 else f" ({hours:.0f} h)"
    )
