"""The answers to the goal of a campaign, by group: they decide about the rounds, and `rtrun verdict` prints them."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from rtfiles.output import counted, printable
from rtfiles.quantities import between, duration, grouped, rounded_up
from rtrun.analysis.deadline import Answer, Verdict
from rtrun.analysis.order.stationarity import Change
from rtrun.analysis.standing import Standing
from rtrun.execution.goal import Progress
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import (
    AS_OFTEN,
    amount,
    bound_text,
    held_for,
    hidden_in_words,
    if_no_miss_comes,
    is_short_of_bursts,
    scope_in_short,
    startup_in_words,
)
from rtrun.plan.goal import Goal
from rtrun.report.tables import Table


def question(study: Study) -> str:
    """The question that is answered."""
    asked = study.question
    return f"asked: {', '.join(filter(None, (study.asked_in_full, asked.on_boots, asked.in_bursts)))}"


def table(standings: Sequence[Standing]) -> Table:
    """A row for each group: its answer and the numbers that it rests on."""
    columns = ("group", "answer", "P(miss)", "misses", "boots", "time")
    rows = [
        (
            _name(standing),
            str(standing.answer),
            bound_text(verdict),
            f"{grouped(verdict.misses)} of {grouped(verdict.n)}" if verdict else "-",
            "-" if verdict is None or verdict.boots is None else str(verdict.boots),
            duration(standing.measured_s),
        )
        for standing in standings
        for verdict in (standing.verdict,)
    ]
    return Table(columns=columns, rows=rows, numbers=range(2, 6))


def reasons(standings: Sequence[Standing]) -> Iterator[str]:
    """What each answer holds for, or lacks: lines for below the table, one for all groups with the same text."""
    by_reason: dict[str, list[str]] = {}
    for standing in standings:
        verdict = standing.verdict
        holds = verdict is not None and standing.answer in (Answer.PROVEN, Answer.IF_INDEPENDENT)
        text = f"holds {scope_in_short(verdict)}" if verdict is not None and holds else missing(standing)
        if text:
            by_reason.setdefault(text, []).append(_name(standing))
    for text, names in by_reason.items():
        everywhere = len(names) > 1 and len(names) == len(standings)
        yield printable(f"{'all groups' if everywhere else ' and '.join(names)}: {text}")


def _name(standing: Standing) -> str:
    return standing.short or standing.label


def startups(standings: Sequence[Standing]) -> Iterator[str]:
    """The start-up that each answer leaves out, one line each, for below the table."""
    for standing in standings:
        if standing.verdict is not None and standing.verdict.startup is not None:
            yield printable(f"{_name(standing)}: {startup_in_words(standing.verdict)}")


def progress_line(progress: Progress, goal: Goal) -> str:
    """The progress of a group in one line, printed while it is measured."""
    standing = progress.standing
    if standing is None or standing.verdict is None:
        return f"{progress.group.name}: nothing is measured yet"
    verdict = standing.verdict
    parts = [f"P(miss) {_bound(verdict)}, to be below {goal.probability:g}", f"{grouped(verdict.n)} measured"]
    if goal.boots > 1 and verdict.boots is not None:
        parts.append(f"{verdict.boots} of {goal.boots} boots")
    if standing.answer is Answer.NEEDS_MORE:
        parts.append(hidden_in_words(verdict) or _remaining(progress.left_s, verdict))
    return f"{standing.answer:{len(Answer.NEEDS_MORE)}}  {printable(standing.label)}: {'; '.join(parts)}"


def _remaining(left_s: float | None, verdict: Verdict) -> str:
    if verdict.change is not None:
        return _changed(verdict.change)
    return f"no end in sight {AS_OFTEN}" if left_s is None else f"about {duration(left_s)} left"


def _changed(change: Change) -> str:
    return f"no answer: {change.what}: {change.text}"


def _bound(verdict: Verdict) -> str:
    """The interval of P(miss)."""
    return f"<= {rounded_up(verdict.upper)}" if verdict.lower == 0 else between(verdict.lower, verdict.upper)


def missing(standing: Standing) -> str:
    """What a group lacks for its answer, and how long measuring it takes; empty when it has an answer."""
    verdict = standing.verdict
    if verdict is None:
        return standing.undecidable or "nothing was measured"
    if verdict.refused:
        return verdict.refused
    if standing.answer is not Answer.NEEDS_MORE:
        return ""
    if hidden := hidden_in_words(verdict):
        return hidden
    if verdict.change is not None:
        return _changed(verdict.change)
    parts = [counted(verdict.boots_missing, "more boot")] if verdict.boots_missing else []
    if is_short_of_bursts(verdict):
        parts.append(f"for {held_for(verdict)} it already holds")
    if verdict.decided_after is None:
        parts.append(f"{AS_OFTEN}, no number of measurements is likely to decide it")
        return "; ".join(parts)
    answer, further = verdict.decided_after
    if further and verdict.misses:
        parts.append(f"{AS_OFTEN}, {amount(verdict, further, 'more')}, then {answer}")
    elif further:
        parts.append(f"{amount(verdict, further, 'more')} prove it {if_no_miss_comes(verdict)}")
    return "; ".join(parts)


def as_data(standings: Sequence[Standing]) -> list[dict[str, Any]]:
    """The same as plain data, for programs."""
    return [
        {
            "group": standing.label,
            "answer": standing.answer,
            "runs": list(standing.runs),
            "measured_s": standing.measured_s,
            "boards": sorted(standing.boards),
            "missing": missing(standing),
            "verdict": None if standing.verdict is None else asdict(standing.verdict),
        }
        for standing in standings
    ]
