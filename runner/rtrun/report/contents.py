"""The contents of a report in reading order; the HTML and the Markdown format write them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from rtfiles.output import counted, printable
from rtfiles.quantities import duration, grouped, time
from rtrun.analysis.deadline import Answer, Verdict
from rtrun.causes.ranking import Ranking
from rtrun.judgement.layers import layer_pairs
from rtrun.judgement.study import Study
from rtrun.judgement.topologies import MeasuredTopology, measured_topologies
from rtrun.judgement.verdicts import ENOUGH_BOOTS, amount, boots_in_words, counts_in_words, is_likely_refuted
from rtrun.kinds.lateness import is_of_periods
from rtrun.report import causes
from rtrun.report.layers import LayerBar, stacks
from rtrun.report.scenarios import Scenario, scenarios
from rtrun.report.sections import ReportInput, sections
from rtrun.report.tables import Table
from rtrun.report.terminal import banner_of
from rtrun.targets.inspection.facts import fact_text
from rtrun.targets.inspection.platform import Platform

MEASURE_AGAIN = (
    "the plots of the report show when; was something else busy? Stop it and measure again, or measure longer"
)
"""What to do about an answer that a change prevents."""


@dataclass(frozen=True, kw_only=True)
class Contents:
    """A report: the answer, what it is based on, every scenario, then the reference sections.

    `worst` is the scenario with the highest value, among those with a deadline if there are any; None: nothing was
    measured. `missing` is the one with the most values missing, if these are many. `why_late` is the main cause of
    outliers; None: none has a trace. `facts` are (what, value). `stacks` are the layers put upon one another,
    `topologies` the measured graphs.
    """

    title: str
    banner: str | None
    answer: str
    worst: Scenario | None
    missing: Scenario | None
    why_late: str | None
    next_step: str
    question: str
    facts: tuple[tuple[str, str], ...]
    scenarios: tuple[Scenario, ...]
    tables: tuple[Table, ...]
    stacks: tuple[tuple[LayerBar, ...], ...]
    topologies: tuple[MeasuredTopology, ...]
    left_out: tuple[str, ...]


def contents(study: Study) -> Contents:
    """Put a study into words."""
    shown, pairs, found = scenarios(study), layer_pairs(study), causes.ranked(study.source)
    topologies = measured_topologies(study)
    # Equal boards decide together whether enough was measured.
    deciding = [
        scenario
        for scenario in shown
        if scenario.group.key not in study.members or scenario.answer != Answer.NEEDS_MORE
    ]
    measured = [scenario for scenario in shown if scenario.figures.max_ns is not None]
    measured = [scenario for scenario in measured if scenario.group.question] or measured
    return Contents(
        title=printable(_title(study, shown)),
        banner=banner_of(study.platform, preempt_rt=study.preempt_rt) or None,
        answer=_answer(study, deciding),
        worst=max(measured, key=lambda scenario: scenario.figures.max_ns or 0, default=None),
        missing=max(
            (scenario for scenario in shown if scenario.missing),
            key=lambda scenario: scenario.missing_share,
            default=None,
        ),
        why_late=causes.answer(found[0]) if found[1] else None,
        next_step=_next_step(deciding, study, found[0]),
        question=_question(study),
        facts=tuple(_facts(study)),
        scenarios=shown,
        tables=sections(ReportInput(study=study, pairs=pairs, found=found, topologies=topologies)),
        stacks=stacks(pairs),
        topologies=topologies,
        # Readers of the report need not know where the results were stored.
        left_out=tuple(printable(text.removeprefix(f"{study.source.path}/")) for text in study.left_out),
    )


def _title(study: Study, shown: Sequence[Scenario]) -> str:
    """What was measured, in as many words as a browser tab shows."""
    what = (
        shown[0].label if len(shown) == 1 else f"{study.source.path.resolve().name}, {counted(len(shown), 'scenario')}"
    )
    return f"{what}: real-time report"


def _question(study: Study) -> str:
    if study.groups and not any(group.question for group in study.groups):
        return "What follows are figures alone: which values are late, a deadline says."
    asked = study.asked
    return f"Asked: {', '.join(filter(None, (study.asked_in_full, 'two-sided', asked.on_boots, asked.in_bursts)))}."


def _answer(study: Study, shown: Sequence[Scenario]) -> str:
    """The answer to the question in one sentence."""
    counts = Counter(scenario.answer for scenario in shown)
    total = len(shown) - counts[Answer.NO_DEADLINE]
    of_total = f" in {{}} of {total} scenarios" if total > 1 else ""
    known_ns = study.deadlines_ns
    deadline = f"the deadline of {time(known_ns[0])}" if len(known_ns) == 1 else "its deadline"
    hidden = f"; {len(study.left_out)} not analysed, see below" if study.left_out else ""
    asked = f"{hidden}. Asked: {study.asked_in_words}."
    if shown and not total:
        return (
            f"Without a deadline there are figures and no answer, for {counted(len(shown), 'scenario')}{hidden}: ask "
            "with --deadline TIME, as --deadline 1ms."
        )
    if not shown:
        return f"Nothing was measured that {deadline} could be held against{hidden}."
    if counts[Answer.REFUTED]:
        failed = of_total.format(counts[Answer.REFUTED]) + _others(shown, Answer.REFUTED)
        return f"{deadline.capitalize()} is not met{failed}{asked}"
    if counts[Answer.PROVEN] + counts[Answer.IF_INDEPENDENT] == total:
        condition = ", unless late values come in bursts" if counts[Answer.IF_INDEPENDENT] else ""
        return (
            f"{deadline.capitalize()} is met in {_all(total)}{condition}: {study.asked_in_words}, "
            f"{_for_which_boots(shown)}{hidden}."
        )
    if counts[Answer.NO_STATEMENT] == total:
        reasons = dict.fromkeys(scenario.group.verdict.refused or "" for scenario in shown if scenario.group.verdict)
        return f"No statement about {deadline} in any scenario: {'; '.join(reasons)}{hidden}."
    open_ = of_total.format(counts[Answer.NEEDS_MORE]) + _others(shown, Answer.NEEDS_MORE)
    undecided = f"t is not decided whether {deadline} is met{open_}{asked}"
    changed = {verdict and verdict.change and verdict.change.what for verdict in _open(shown)}
    why = changed.pop() if len(changed) == 1 else None
    return f"{why.capitalize()}, so i{undecided}" if why else f"I{undecided}"


def _open(shown: Sequence[Scenario]) -> list[Verdict | None]:
    """The verdicts that decide nothing; None where there is not even one."""
    return [scenario.group.verdict for scenario in shown if scenario.answer == Answer.NEEDS_MORE]


def _others(shown: Sequence[Scenario], answer: Answer) -> str:
    """In how many scenarios there are other answers than this one."""
    words = counts_in_words([scenario.answer for scenario in shown if scenario.answer != answer])
    return f", {words}" if words else ""


def _for_which_boots(shown: Sequence[Scenario]) -> str:
    """The boots that the proofs apply to: the weakest statement over all scenarios."""
    verdicts = [scenario.group.verdict for scenario in shown if scenario.group.verdict]
    if any(verdict.boots is None for verdict in verdicts):
        return "on boots that were not recorded"
    return boots_in_words(min(verdicts, key=lambda verdict: verdict.boots or 0))


def _all(total: int) -> str:
    return "the one scenario" if total == 1 else f"all {total} scenarios"


def _next_step(shown: Sequence[Scenario], study: Study, culprits: Ranking) -> str:
    """What to do next: where values are late and traces name a cause, its remedy."""
    answers = {scenario.answer for scenario in shown}
    if culprits.outliers and answers & {Answer.REFUTED, Answer.NEEDS_MORE, Answer.NO_DEADLINE}:
        advice = next(causes.remedies(culprits), "")
        return f"{causes.answer(culprits)}{f'. {advice}' if advice else ''}"
    open_ = [verdict for verdict in _open(shown) if verdict]
    bad = [verdict for scenario in shown if (verdict := scenario.group.verdict) and is_likely_refuted(verdict)]
    undecided = bad or [verdict for verdict in open_ if verdict.decided_after is None]
    if undecided and all(
        verdict.absent > verdict.late and not is_of_periods(verdict.question.of) for verdict in undecided
    ):
        return "find out where values are lost: queues and their depth, quality of service, the network, a busy thread"
    if bad:
        return (
            "rtrun check-rt --target TARGET.yml lists what stands in the way of real time on the target; "
            "the plots of the report show when the late values came"
        )
    if any(verdict.change for verdict in open_):
        return MEASURE_AGAIN
    wanted = [(decided[1], verdict) for verdict in open_ if (decided := verdict.decided_after) and decided[1]]
    if wanted:
        count, verdict = max(wanted, key=lambda pair: pair[0])
        decides = "are likely to decide it" if verdict.misses else "without a late one decide it"
        return f"measure more: {amount(verdict, count, 'measurements')} a scenario {decides}"
    if answers and answers <= {Answer.NO_STATEMENT}:
        return "measure where the time is real, on the board itself: rtrun run CAMPAIGN.yml --target BOARD.yml"
    if answers == {Answer.PROVEN} and study.left_out:
        return "find out why not all was analysed: rtrun gate RESULTS fails because of that"
    if answers == {Answer.PROVEN}:
        option = " --platform virtual" if study.platform is Platform.VIRTUAL else ""
        gate = f"rtrun gate RESULTS{option} fails as soon as this no longer holds"
        boots = min(scenario.group.verdict.boots_known for scenario in shown if scenario.group.verdict)
        more = f"measure on {ENOUGH_BOOTS} boots or more, as boots differ; " if boots < ENOUGH_BOOTS else ""
        return f"{more}then keep it so: {gate}" if more else f"keep it so: {gate}"
    if answers and answers <= {Answer.PROVEN, Answer.IF_INDEPENDENT}:
        return "measure with samples, which show whether late values come in bursts; histograms and logs cannot"
    if answers == {Answer.NO_DEADLINE}:
        return "say which values are late: rtrun report RESULTS --deadline TIME"
    return f"see {'what is missing in each scenario' if shown else 'why it could not be analysed'}"


def _facts(study: Study) -> list[tuple[str, str]]:
    """What was measured, and where."""
    targets = [record.target for record in study.records]
    real_time = {True: "PREEMPT_RT", False: "without PREEMPT_RT", None: "PREEMPT_RT not known"}
    boots = {str(target.boot_id) for target in targets if target.boot_id}
    # Streams that were observed at the same time count that time once.
    at_once = {(record.start_time, record.end_time): record for record in study.records if record.subject == "attached"}
    started = [record for record in study.records if record.subject == "started"]
    seconds = sum(record.duration_s for record in (*started, *at_once.values()))
    measurements = grouped(sum(group.n for group in study.groups))
    days = sorted({record.start_time[:10] for record in study.records if record.start_time})
    kernels = [text for target in targets if (text := fact_text(target.kernel_release))]
    values = f"{measurements} values" + (f", {' to '.join(dict.fromkeys((days[0], days[-1])))}" if days else "")
    facts = [
        ("board", ", ".join(dict.fromkeys(target.name for target in targets))),
        ("platform", ", ".join(dict.fromkeys(f"{run.platform}: {run.platform_evidence}" for run in study.records))),
        ("kernel", ", ".join(dict.fromkeys(kernels))),
        ("real time", ", ".join(dict.fromkeys(real_time[target.preempt_rt] for target in targets))),
        ("CPUs", ", ".join(dict.fromkeys(str(target.cpus) for target in targets if target.cpus))),
        ("runs", str(len(study.records)) if study.records else ""),
        ("boots", str(len(boots)) if boots else ""),
        ("time", duration(seconds) if seconds else ""),
        ("measured", values),
    ]
    return [(what, printable(value)) for what, value in facts if value]
