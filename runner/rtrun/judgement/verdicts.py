"""A verdict in words: the answer, and the numbers that it rests on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rtfiles.output import counted, listed, printable
from rtfiles.quantities import between, duration, grouped, percent, percent_at_most, rounded_down, rounded_up, time
from rtrun.analysis.account import HOURS
from rtrun.analysis.deadline import Answer, Unlike, Verdict, judge
from rtrun.analysis.order.trends import LEAST_UNITS, Climb
from rtrun.judgement.boards import spread
from rtrun.judgement.groups import Group
from rtrun.kinds.lateness import absent_in_words, is_late
from rtrun.plan.question import NONE_TOLERATED, STALL_NS, UNKNOWN_PERIOD_NS

# Fewer boots say too little about how boots differ: Student's t widens by more than twice (docs/analysis.md).
ENOUGH_BOOTS = 5
_LOST_SHOWN = 3
AS_OFTEN = "if misses stay as frequent"
# The order in which answers are shown.
WORST_FIRST = (
    *(Answer.REFUTED, Answer.NEEDS_MORE, Answer.IF_INDEPENDENT, Answer.PROVEN),
    *(Answer.NO_STATEMENT, Answer.NO_DEADLINE),
)


_COUNTED = {
    Answer.REFUTED: "{no} in {n}",
    Answer.PROVEN: "{yes} in {n}",
    Answer.IF_INDEPENDENT: "{yes} in {n} unless late values come in bursts",
    Answer.NEEDS_MORE: "not known yet in {n}",
    Answer.NO_STATEMENT: "no statement in {n}",
}


def counts_in_words(answers: Sequence[str], yes: str = "met", no: str = "not met", of_what: str = "") -> str:
    """In how many scenarios a deadline is met; those without a deadline do not count.

    `of_what` follows the first number.
    """
    counts = [(words, n) for answer, words in _COUNTED.items() if (n := answers.count(answer))]
    return ", ".join(
        words.format(yes=yes, no=no, n=n if place else f"{n}{of_what}") for place, (words, n) in enumerate(counts)
    )


def severity(answer: str, worst_ns: int | None) -> tuple[int, float]:
    """Sorts scenarios: the worst answer first, and within an answer the highest value first."""
    return WORST_FIRST.index(Answer(answer)), math.inf if worst_ns is None else -worst_ns


@dataclass(frozen=True, kw_only=True)
class VerdictLine:
    """A verdict in one line: its answer, its subject, and the numbers."""

    answer: str
    about: str
    text: str


def verdict_line(group: Group, name: str = "") -> VerdictLine:
    """The verdict of a group in one line; `name` is the group's name, by default its label."""
    verdict, about = group.verdict, printable(name or group.label)
    if verdict is None:
        answer = Answer.NEEDS_MORE if group.question else Answer.NO_DEADLINE
        return VerdictLine(answer=answer, about=about, text=group.undecidable or "nothing was measured")
    return VerdictLine(answer=verdict.answer, about=about, text=_numbers(verdict, group))


def _numbers(verdict: Verdict, group: Group) -> str:
    parts = sentences(verdict)
    startup_ns = [value.value_ns for digest in group.digests for value in digest.header.startup]
    late_start = [value_ns for value_ns in startup_ns if is_late(value_ns, verdict.question.limit_ns)]
    if late_start:
        parts.append(f"start-up apart: {len(late_start)} late, worst {time(max(late_start))}")
    if group.members:
        parts.append(f"of single boards: {spread(group)}")
    parts += [f"assumes {text}" for text in verdict.assumes]
    return "; ".join(parts)


def sentences(verdict: Verdict) -> list[str]:
    """The numbers of a verdict, what it holds for, and what it lacks."""
    what = "late" if verdict.question.tolerance == NONE_TOLERATED else "windows hold too many misses"
    parts = [f"{grouped(verdict.late)} of {grouped(verdict.n)} {what}"]
    if verdict.absent:
        parts[0] += f" and {absent_in_words(verdict.absent, verdict.question.of)}"
    parts.append(f"P({verdict.question.miss}) {_between(verdict)}")
    if episodes := _episodes(verdict):
        parts.append(episodes)
    if verdict.worst_ns is not None:
        parts.append(f"worst {time(verdict.worst_ns)}")
    if startup := startup_in_words(verdict):
        parts.append(startup)
    if verdict.n_effective * 1.005 < verdict.n:
        why = "dependent values" if verdict.design_effect > 1.005 else "boots count alike, however long"
        parts.append(f"{why}: worth {grouped(verdict.n_effective)} independent measurements")
    if verdict.refused:
        parts.insert(0, verdict.refused)
    elif verdict.change is not None:
        change = f"{verdict.change.what}: {verdict.change.text} ({_chance(verdict.change.p_value)})"
        parts.insert(0 if verdict.answer == Answer.NEEDS_MORE else len(parts), change)
    if hidden := hidden_in_words(verdict):
        parts.insert(0 if verdict.answer == Answer.NEEDS_MORE else len(parts), hidden)
    parts += [_reached_in_words(climb) for climb in verdict.climbs if climb.reached_after is not None]
    if verdict.answer == Answer.NEEDS_MORE:
        parts += _more(verdict)
    elif verdict.answer == Answer.REFUTED:
        parts += _of_whom(verdict)
    elif verdict.answer in (Answer.PROVEN, Answer.IF_INDEPENDENT):
        parts += _scope(verdict)
    return parts


def _chance(p_value: float) -> str:
    return f"p = {p_value:.1g}" if p_value > 1e-99 else "p below 1e-99"


def startup_in_words(verdict: Verdict) -> str:
    """The start-up that a verdict leaves out; empty if there is none."""
    startup = verdict.startup
    if startup is None:
        return ""
    held = [f"{grouped(startup.late)} late"]
    if startup.absent:
        held.append(f"{grouped(startup.absent)} never came")
    if startup.worst_ns is not None:
        held.append(f"worst {time(startup.worst_ns)}")
    return (
        f"start-up: the first {grouped(startup.loops)} loops of each run are left out "
        f"({', '.join(held)}; {_chance(startup.p_value)}): the answer is of what follows"
    )


def hidden_in_words(verdict: Verdict) -> str:
    """Attempts without values, and time that load hid, both of which count as late; empty if there are none."""
    parts = []
    if verdict.lost:
        total = verdict.runs + len(verdict.lost)
        more = verdict.units_missing
        outweighed = "" if not more else f"; it takes {counted(more, f'more {verdict.unit}')} to outweigh that"
        parts.append(
            f"{len(verdict.lost)} of {counted(total, 'attempt')} gave no values ({listed(verdict.lost, _LOST_SHOWN)}) "
            f"and count as late{outweighed}"
        )
    if verdict.hidden_share:
        parts.append(f"{percent(verdict.hidden_share)} of the time was not seen because of load, and counts as late")
    return "; ".join(parts)


def _episodes(verdict: Verdict) -> str:
    """How often episodes of misses come, and how long they last; empty if neither is known."""
    found = verdict.episodes
    if found is None or (found.per_hour_at_most is None and not found.seen):
        return ""
    longest = "single misses" if found.longest_misses == 1 else f"the longest of {grouped(found.longest_misses)} misses"
    if found.longest_misses > 1 and found.longest_ns is not None:
        longest += f" within {time(found.longest_ns)}"
    seen = f"{grouped(found.seen)} seen, {longest}" if found.seen else "none seen"
    what = "misses" if verdict.question.tolerance == NONE_TOLERATED else "such windows"
    if found.per_hour_at_most is None:
        return f"episodes of {what}: {seen}"
    most = found.per_hour_at_most
    return (
        f"at most {grouped(math.ceil(most)) if most >= 100 else rounded_up(most)} episodes of {what} an hour ({seen})"
    )


def bound_text(verdict: Verdict | None) -> str:
    """The deciding bound of P(miss), for a table; a dash if there is none."""
    if verdict is None or verdict.refused or (verdict.answer == Answer.NEEDS_MORE and _has_no_rate(verdict)):
        return "-"
    is_refuted = verdict.answer == Answer.REFUTED
    return f">= {rounded_down(verdict.lower)}" if is_refuted else f"<= {rounded_up(verdict.upper)}"


def _has_no_rate(verdict: Verdict) -> bool:
    """Whether the measurements have no single rate of misses, or hide an unknown part."""
    return verdict.change is not None or bool(hidden_in_words(verdict))


def _between(verdict: Verdict) -> str:
    if verdict.lower == 0:
        return f"at most {rounded_up(verdict.upper)}"
    return between(verdict.lower, verdict.upper)


def scope_in_short(verdict: Verdict) -> str:
    """What a proof holds for, in a few words."""
    unlike = verdict.unlike_boots
    share = ""
    if unlike and unlike.measured > 1:
        most = percent_at_most(unlike.share)
        share = f" ({unlike.measured} boots can miss another kind, even one that is {most} of all boots)"
    if verdict.answer == Answer.IF_INDEPENDENT:
        return f"{boots_in_words(verdict)}{share}, unless late values come in bursts"
    whole = math.floor(verdict.longest_burst)
    asked = f" ({grouped(verdict.bursts.length)} asked)" if 1 < verdict.bursts.length < whole else ""
    bursts = f"even if late values come {grouped(whole)} in a row{asked}" if whole > 1 else "if late values come singly"
    if whole <= 1 and verdict.bursts.why == "stall":
        bursts += f" (a burst of {time(STALL_NS)} has one)"
    return f"{boots_in_words(verdict)}{share}, {bursts}"


def boots_in_words(verdict: Verdict) -> str:
    """The boots, or boards, that a verdict is about."""
    if verdict.boards > 1:
        return f"for the {verdict.boards} boards together"
    if verdict.boots is None:
        return "on boots that were not recorded"
    if verdict.boots == 1:
        return "in this boot"
    return f"on boots like the {verdict.boots} that were measured"


def held_for(verdict: Verdict) -> str:
    """The bursts for which a verdict holds, if nothing else is missing."""
    whole = math.floor(verdict.longest_burst)
    return f"bursts of up to {grouped(whole)} misses" if whole > 1 else "misses that come singly"


def is_short_of_bursts(verdict: Verdict) -> bool:
    """Whether it would be proven if it had to cover only misses that come singly."""
    is_open = verdict.answer is Answer.NEEDS_MORE and verdict.change is None and not verdict.boots_missing
    return is_open and 0 < verdict.longest_burst < verdict.bursts.length


def is_likely_refuted(verdict: Verdict) -> bool:
    """Whether it is refuted, or will be if misses continue at the rate seen."""
    likely = verdict.further_likely if verdict.change is None else None
    return verdict.answer is Answer.REFUTED or (likely is not None and likely[0] is Answer.REFUTED)


def answer_to(group: Group, probability: float) -> str:
    """The answer of a group to the same question about another probability; its own answer if it cannot be judged."""
    if group.account is None or group.verdict is None:
        return verdict_line(group).answer
    return judge(group.account, replace(group.verdict.question, probability=probability)).answer


def _covered(verdict: Verdict) -> str:
    """The bursts that a proof covers by default, and why; empty if the question names them."""
    bursts = verdict.bursts
    long = f"{grouped(bursts.length)} misses in a row" if bursts.length > 1 else "a single miss"
    match bursts.why:
        case "asked":
            return ""
        case "stall":
            return f"bursts of {time(STALL_NS)} ({long}, the default)"
        case "longest seen":
            return f"the longest burst that was seen ({long}, the default)"
        case "period not known":
            unknown = f"the period is not known and counts as {time(UNKNOWN_PERIOD_NS)}"
            return f"bursts of {time(STALL_NS)} ({long}, the default; {unknown})"


def _of_whom(verdict: Verdict) -> list[str]:
    """The boots, boards and hours that an answer holds for, and those that are unknown to it."""
    return _boots(verdict) + [words for unlike in verdict.unlike if (words := _unlike_in_words(unlike))]


def _scope(verdict: Verdict) -> list[str]:
    """What a proof holds for: bursts, boots, boards, hours and time."""
    more = [f"{amount(verdict, count)} for bursts of {length}" for length, count in verdict.further_for_bursts]
    parts = [f"holds for {held_for(verdict)}" + (f" (without a miss, {', '.join(more)})" if more else "")]
    parts += [f"covers {covered}"] if (covered := _covered(verdict)) else []
    parts += _of_whom(verdict)
    parts += [_unseen_in_words(climb) for climb in verdict.climbs[:1] if climb.smallest_ns != 0]
    if verdict.unseen_share:
        parts.append(f"holds for the {percent(1 - verdict.unseen_share)} of the time that was seen")
    return parts


def _unlike_in_words(unlike: Unlike) -> str:
    """What may differ from what was measured; other sentences cover boots, and a single run or board."""
    if unlike.unit == "hour":
        return f"measured in {unlike.measured} of the {HOURS} hours of a day" if unlike.measured < HOURS else ""
    if unlike.unit == "boot" or unlike.measured < 2:
        return ""
    return _of_another_kind(unlike)


def _of_another_kind(unlike: Unlike) -> str:
    share = f"{unlike.unit}s of another kind may be up to {percent_at_most(unlike.share)} of all"
    if not unlike.short:
        return share
    are = "are" if unlike.short > 1 else "is"
    return f"{share}, since {unlike.short} of the {unlike.measured} {unlike.unit}s {are} too short to show their kind"


def _reached_in_words(climb: Climb) -> str:
    after = counted(math.ceil(climb.reached_after or 0), f"more {climb.unit}")
    return (
        f"the highest value climbs from {climb.unit} to {climb.unit}: at this pace the deadline is reached in {after}"
    )


def _unseen_in_words(climb: Climb) -> str:
    """The largest climb that so few units may not have shown."""
    if climb.smallest_ns is None and climb.units >= LEAST_UNITS:
        return f"{climb.unit}s of such lengths, or so alike, do not show how small a climb they would have shown"
    if climb.smallest_ns is None:
        return f"{counted(climb.units, climb.unit)} {'are' if climb.units > 1 else 'is'} too few to show a climb"
    smallest = time(float(f"{climb.smallest_ns:.2g}"))
    return f"a climb of less than {smallest} from {climb.unit} to {climb.unit} would not have been seen"


def _boots(verdict: Verdict) -> list[str]:
    if verdict.boards > 1:
        few = f"; for boards of this kind measure on {ENOUGH_BOOTS} or more"
        return [f"holds for the {verdict.boards} boards together{few if verdict.boards < ENOUGH_BOOTS else ''}"]
    if (unlike := verdict.unlike_boots) is None:
        return ["the boot of some runs is not known: if all are of one boot, it holds for that one"]
    if verdict.boots == 1:
        return [f"holds for the boot that was measured; for the system measure on {ENOUGH_BOOTS} boots or more"]
    return [f"measured on {verdict.boots} boots: {_of_another_kind(unlike)}"]


def _more(verdict: Verdict) -> list[str]:
    parts = [counted(verdict.boots_missing, "more boot")] if verdict.boots_missing else []
    if verdict.change is not None:
        if verdict.change.missing_loops:
            parts.append(
                f"a load that comes and goes is part of the process once it has come back five times: "
                f"{amount(verdict, verdict.change.missing_loops)}"
            )
        return parts
    if hidden_in_words(verdict):
        return parts
    if is_short_of_bursts(verdict):
        parts.append(f"for {held_for(verdict)} it already holds")
    if verdict.bursts.length > 1:
        parts.append(f"has to cover {_covered(verdict) or verdict.question.covered}")
    if verdict.further:
        parts.append(
            f"{amount(verdict, verdict.further)} prove it {if_no_miss_comes(verdict)}"
            + (", if dependence stays as seen" if verdict.design_effect > 1.005 else "")
        )
    if verdict.further_likely is not None and verdict.further_likely[1]:
        answer, count = verdict.further_likely
        parts.append(f"{AS_OFTEN}, {answer} after {amount(verdict, count)} nine times in ten")
    elif verdict.misses and verdict.further_likely is None:
        parts.append(f"{AS_OFTEN}, no number of measurements is likely to decide it")
    return parts


def if_no_miss_comes(verdict: Verdict) -> str:
    """On which condition `further` measurements prove it, and how likely that is where no miss was seen."""
    if verdict.misses:
        return "if no other miss comes"
    if verdict.further_chance >= 0.995 or not verdict.n:
        return "if no miss comes"
    chance = f"the chance of that is {percent(verdict.further_chance)}"
    return f"if no miss comes; after {grouped(verdict.n)} without one, {chance}"


def amount(verdict: Verdict, count: int, what: str = "more measurements") -> str:
    """How many measurements are missing, and how long they take, if that is known."""
    hours = verdict.hours(count)
    return f"{grouped(count)} {what}" + ("" if hours is None else f" ({duration(hours * 3600)})")
