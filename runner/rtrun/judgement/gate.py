"""Does a campaign pass? There is a case for every group of similar runs, and for everything that was not analysed."""

from collections.abc import Container, Iterator
from dataclasses import dataclass

from rtfiles.output import counted
from rtrun.analysis.deadline import Answer
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import bound_text, hidden_in_words, sentences, severity, startup_in_words, verdict_line
from rtrun.plan.question import Question, weaker
from rtrun.plan.suites import suites
from rtrun.plan.topology.planning import SUITE as TOPOLOGY
from rtrun.results.record import RunRecord
from rtrun.targets.inspection.platform import Platform, weakest

ALLOCATIONS, PAGE_FAULTS, ASKS_LESS = "ALLOCATIONS", "PAGE FAULTS", "ASKS LESS"
NO_DEADLINE = "nothing that was measured has a deadline: give one, as --deadline 1ms"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One answer on which the gate depends, with its numbers; None if there are none."""

    about: str
    answer: str
    text: str
    passed: bool
    short: str = ""
    """A shorter name than `about`, where there is one."""
    n: int | None = None
    misses: int | None = None
    worst_ns: int | None = None
    bound: str = "-"
    """The bound of P(miss) that decides."""
    refused: str | None = None
    """Why there is no answer: `text` begins with it."""
    reason: str | None = None
    """What made the answer besides its numbers, "" if nothing did; `text` where it is None."""
    not_accepted: str = ""
    """Why a proof does not pass."""
    changed: tuple[str, ...] = ()
    """What changed since the last boot of an archive before it, where it is worse."""

    @property
    def in_full(self) -> str:
        """`text`, and what changed."""
        return f"{self.text}; changed since its last boot: {'; '.join(self.changed)}" if self.changed else self.text


@dataclass(frozen=True, kw_only=True)
class Gate:
    """All cases, not analysed first, then worst first; `passed` when there is one and every one passed."""

    cases: tuple[Case, ...]

    @property
    def passed(self) -> bool:
        """Whether the gate lets the campaign through."""
        return bool(self.cases) and all(case.passed for case in self.cases)


def gate(
    study: Study,
    *,
    assume_independent: bool = False,
    platform: Platform = Platform.HARDWARE,
    max_page_faults: int | None = None,
    max_allocations: int | None = None,
    goal: Question | None = None,
) -> Gate:
    """Judge a study. Only a proof passes: neither too little data nor an emulated board is one.

    Measurements on a virtual machine pass only where `platform` is virtual. A proof that needs independent
    measurements, from counts without order, passes only with `assume_independent`. For boards that are alike, the
    answer for all of them counts; a single board fails only if it is refuted. A run that failed, is incomplete or was
    refused does not pass, because it may hide anything. An attempt that a restart of the target cut off is named, and
    passes if its run was measured again. With `max_page_faults`, no program of a suite may have had more while it
    measured; with `max_allocations`, the same holds for programs that counted them. A question weaker than the `goal`
    of the campaign does not pass.
    """
    passing = {Answer.PROVEN, Answer.IF_INDEPENDENT} if assume_independent else {Answer.PROVEN}
    cases = [
        Case(about=text.split(":", 1)[0], answer="NOT ANALYSED", text=text.split(":", 1)[-1].strip(), passed=False)
        for text in study.left_out
    ]
    judged = [
        _case(group, study, passing, platform, is_member=group.key in study.members)
        for group in study.answers
        if group.question
    ]
    cases += sorted(judged, key=lambda case: severity(case.answer, case.worst_ns))
    if study.answers and not judged:
        cases.append(Case(about="deadline", answer="NOT ANALYSED", text=NO_DEADLINE, passed=False))
    cases += [
        Case(about=name, answer="REPEATED", text="cut off by a restart of the target, then measured again", passed=True)
        for name in study.source.repeated
    ]
    if goal is not None and (less := weaker(goal, study.question, _bursts_by_default(study))):
        text = f"it asks less than the goal of the campaign: {'; '.join(less)}; to ask that instead: --instead-of-goal"
        cases.insert(0, Case(about="question", answer=ASKS_LESS, text=text, passed=False))
    if max_page_faults is not None:
        telling = [record for record in study.records if record.suite in (*suites().suites, TOPOLOGY)]
        text = "nobody counted them: the programs of these runs are no suite's"
        cases += [case for record in telling for case in _page_faults(record, max_page_faults)]
        cases += [] if telling else [Case(about="page faults", answer=PAGE_FAULTS, text=text, passed=False)]
    if max_allocations is not None:
        counted_cases = [case for record in study.records for case in _allocations(record, max_allocations)]
        text = "nobody counted them: give a campaign allocations: [null, counted]"
        cases += counted_cases or [Case(about="allocations", answer=ALLOCATIONS, text=text, passed=False)]
        if not study.answers:
            text = "no run was measured but those that count allocations, whose times are not judged"
            cases.append(Case(about="deadline", answer="NOT ANALYSED", text=text, passed=False))
    return Gate(cases=tuple(cases))


def _bursts_by_default(study: Study) -> int:
    """The bursts that a proof of each group covers if the question does not set them."""
    return max((group.verdict.bursts_by_default for group in study.answers if group.verdict), default=1)


def _page_faults(record: RunRecord, most: int) -> Iterator[Case]:
    """A case for each program that had more page faults than allowed, or does not report them."""
    for program in record.programs:
        faults = program.costs.page_faults if program.costs else None
        if faults is None or faults > most:
            had = "it does not tell how many it had" if faults is None else counted(faults, "page fault")
            text = f"{had} while it measured, {most} allowed"
            yield Case(about=f"{record.run} {program.name}", answer=PAGE_FAULTS, text=text, passed=False)


def _allocations(record: RunRecord, most: int) -> Iterator[Case]:
    """A case for each program of a suite that counted its allocations."""
    for program in record.programs:
        if program.costs and (number := program.costs.allocations) is not None:
            text = f"{counted(number, 'allocation')} while it measured, {most} allowed"
            yield Case(about=f"{record.run} {program.name}", answer=ALLOCATIONS, text=text, passed=number <= most)


def why_not_accepted(measured: Platform, accepted: Platform) -> str | None:
    """Why a gate that accepts `accepted` does not pass measurements on a platform; None if it does."""
    if weakest((measured, accepted)) is accepted:
        return None
    if measured is Platform.EMULATED:
        return f"measured on {measured.machine}, where times mean nothing"
    return f"measured on {measured.machine}: passes only with --platform {measured}"


def _case(group: Group, study: Study, passing: Container[str], platform: Platform, *, is_member: bool) -> Case:
    line, verdict = verdict_line(group, study.name(group)), group.verdict
    text, passed = line.text, line.answer in passing
    reason = not_accepted = ""
    if verdict is None:
        reason = text
    elif verdict.answer == Answer.NEEDS_MORE and (verdict.change is not None or hidden_in_words(verdict)):
        reason = sentences(verdict)[0]
    if verdict is not None:
        reason = "; ".join(filter(None, (reason, startup_in_words(verdict))))
    if is_member and line.answer == Answer.NEEDS_MORE:
        # The case of all boards together shows whether they have measured enough.
        passed = True
    if passed and not all(record.target.is_identified for record in group.records):
        not_accepted = "of an unknown board: import it with --board"
    elif passed:
        not_accepted = why_not_accepted(group.platform, platform) or ""
    if not_accepted:
        text, passed = f"{text}; {not_accepted}", False
    return Case(
        about=line.about,
        answer=line.answer,
        text=text,
        passed=passed,
        short=study.short_name(group),
        n=verdict.n if verdict else group.n,
        misses=verdict.misses if verdict else None,
        worst_ns=verdict.worst_ns if verdict else None,
        bound=bound_text(verdict),
        refused=verdict.refused if verdict else None,
        reason=reason,
        not_accepted=not_accepted,
    )
