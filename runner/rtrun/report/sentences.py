"""The answers in sentences, for somebody who knows no statistics: what `quick` and `report` print."""

from collections.abc import Sequence

from rtfiles.output import counted
from rtfiles.quantities import at_least_in, at_most_in, duration, grouped, one_in, time
from rtrun.analysis.deadline import Answer, Verdict
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import (
    AS_OFTEN,
    counts_in_words,
    hidden_in_words,
    is_short_of_bursts,
    startup_in_words,
)
from rtrun.kinds.lateness import absent_in_words
from rtrun.plan.question import NONE_TOLERATED
from rtrun.report.scenarios import Scenario
from rtrun.report.tables import Table


def headline(study: Study, shown: Sequence[Scenario]) -> str:
    """Where the deadline was missed, and on what kind of machine."""
    judged = [scenario for scenario in shown if scenario.group.verdict]
    if not judged:
        return "Nothing was measured that counts."
    missed = sum(bool(scenario.group.verdict and scenario.group.verdict.misses) for scenario in judged)
    tests = counted(len(judged), "test")
    deadline = time(study.deadlines_ns[0]) if len(study.deadlines_ns) == 1 else "A deadline"
    which = "never missed in" if not missed else "missed at least once in"
    if missed and len(judged) > 1:
        which += " all" if missed == len(judged) else f" {missed} of"
    sure = f"{100 * study.question.confidence:g} % sure"
    return f"{deadline} was {which} {tests} {_where(study)}. How many are late, {sure}:"


def _where(study: Study) -> str:
    machine = study.platform.machine
    known = {record.target.preempt_rt for record in study.records}
    kernel = " with PREEMPT_RT" if known == {True} else " without PREEMPT_RT" if known == {False} else ""
    return f"on {machine}{kernel}"


def lines(study: Study, shown: Sequence[Scenario]) -> Table:
    """A line for each scenario with a deadline: its short name, how many were late, and what follows from that."""
    rows = []
    refusals = {scenario.group.verdict.refused if scenario.group.verdict else None for scenario in shown}
    # The headline has a reason that applies to all.
    common = f", {refusals.pop()}" if len(shown) > 1 and len(refusals) == 1 else ""
    for scenario in shown:
        text = sentence(scenario)
        if scenario.group.key in study.members and scenario.answer == Answer.NEEDS_MORE:
            # All boards together are decided, or say what is missing.
            text = f"{text.partition(';')[0]}; not decided for this board alone: see all boards together"
        rows.append((study.short_name(scenario.group), text.removesuffix(common)))
    return Table(columns=("", ""), rows=rows)


def sentence(scenario: Scenario) -> str:
    """What was measured in a scenario with a deadline, and what follows from it."""
    verdict = scenario.group.verdict
    if verdict is None:
        return scenario.group.undecidable or "nothing was measured"
    return f"{_seen(verdict)}: {'; '.join(_follows(verdict))}"


def _seen(verdict: Verdict) -> str:
    tolerance = verdict.question.tolerance
    what = "late" if tolerance == NONE_TOLERATED else f"windows with more than {tolerance} late"
    parts = [f"{grouped(verdict.late) if verdict.late else 'none'} of {grouped(verdict.n)} {what}"]
    if verdict.absent:
        parts.append(absent_in_words(verdict.absent, verdict.question.of))
    if verdict.worst_ns is not None:
        parts.append(f"worst {time(verdict.worst_ns)}")
    return ", ".join(parts)


def _follows(verdict: Verdict) -> list[str]:
    late = "late or missing" if verdict.absent else "late"
    most = f"at most {at_most_in(verdict.upper)} are {late}"
    startup = [text] if (text := startup_in_words(verdict)) else []
    if verdict.refused:
        return [f"no statement, {verdict.refused}", *startup]
    match verdict.answer:
        case Answer.REFUTED:
            changed = [f"{verdict.change.what} ({verdict.change.text})"] if verdict.change else []
            return [f"too many, at least {at_least_in(verdict.lower)} are {late}", *changed, *startup]
        case Answer.PROVEN:
            return [most, *startup]
        case Answer.IF_INDEPENDENT:
            return [f"{most}, unless they come in bursts", *startup]
        case _:
            return [*_open(verdict, most), *startup]


def _open(verdict: Verdict, most: str) -> list[str]:
    """Why it is not decided, and what decides it."""
    if hidden := hidden_in_words(verdict):
        return [f"no upper limit can be given: {hidden}"]
    if verdict.change is not None:
        return [f"{verdict.change.what}, so no upper limit can be given ({verdict.change.text})"]
    asked = one_in(verdict.question.probability)
    decided = verdict.decided_after
    if decided is not None and decided[0] is Answer.REFUTED:
        return [f"probably more than {asked}; {_measuring(verdict, decided[1])} would prove that"]
    parts, prove = [most], f"prove at most {asked}"
    if is_short_of_bursts(verdict):
        longest = int(verdict.longest_burst)
        parts = [f"{most} if {f'no more than {longest} come in a row' if longest > 1 else 'they come singly'}"]
        prove += f", even if they come {verdict.bursts.length} in a row"
    if verdict.boots_missing:
        parts.append(f"{counted(verdict.boots_missing, 'more boot')} missing")
    if decided is None:
        parts.append(f"{AS_OFTEN}, more measuring is not likely to decide it")
    elif decided[1]:
        how = "probably" if verdict.misses else "without a late one"
        parts.append(f"{_measuring(verdict, decided[1])} {how} {prove}")
    return parts


def _measuring(verdict: Verdict, count: int) -> str:
    hours = verdict.hours(count)
    return f"{grouped(count)} more values" if hours is None else f"{duration(hours * 3600)} more of measuring"


def answers_in_words(answers: Sequence[str], probability: str) -> str:
    """How many tests meet a question: "At most 1 in 100 late? No in 1 of 4 tests, yes in 3."."""
    tests = sum(answer != Answer.NO_DEADLINE for answer in answers)
    met = counts_in_words(answers, "yes", "no", " test" if tests == 1 else f" of {tests} tests")
    return f"At most {probability} late? {met[:1].upper()}{met[1:]}."
