"""Is a deadline met, with what probability, and how sure is that?"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

import numpy as np

from rtrun.analysis.account import HOURS, Account
from rtrun.analysis.chance.distributions import chi_squared_above, normal_quantile, student_quantile
from rtrun.analysis.chance.further import (
    chance_of_no_miss,
    likely_further,
    longest_burst,
    missing_without_miss,
    smallest,
)
from rtrun.analysis.chance.intervals import anytime_lower, anytime_upper, clopper_pearson, of_few
from rtrun.analysis.dependence.design_effect import Events, cluster_effect, design_effect, effect_of_few, pool
from rtrun.analysis.dependence.episodes import Episodes, per_hour
from rtrun.analysis.dependence.units import Cluster, CountedRun, boots_of, count_alike, shorter, sums
from rtrun.analysis.order.constancy import examine_constancy, find_climbs, join_boots
from rtrun.analysis.order.startup import LeftOut
from rtrun.analysis.order.stationarity import SIGNIFICANT, Change
from rtrun.analysis.order.trends import Climb
from rtrun.analysis.trials import ENOUGH_MISSES, Trials
from rtrun.plan.question import NONE_TOLERATED, Bursts, Question, bursts_asked

# For these lengths of bursts, a proof says how many more measurements would cover them.
BURSTS = (20, 50)


class Answer(StrEnum):
    """What can be said about a deadline."""

    PROVEN = "PROVEN"
    IF_INDEPENDENT = "PROVEN IF INDEPENDENT"
    REFUTED = "REFUTED"
    NEEDS_MORE = "NEEDS MORE"
    NO_STATEMENT = "not a real-time statement"
    NO_DEADLINE = "no deadline"


@dataclass(frozen=True, kw_only=True, slots=True)
class Unlike:
    """Units of another kind may exist, though none was among those `measured`: at most this `share` of all units.

    The share holds at the requested confidence. `short` of the measured units are too short to show of which kind they
    are, so they count as another kind. For hours, the share is the part of the day in which nothing was measured.
    """

    unit: Literal["run", "boot", "board", "hour"]
    measured: int
    share: float
    short: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The answer to one deadline.

    ``lower`` and ``upper`` bound P(miss) at the confidence asked for, however often somebody looks
    (`anytime_interval`). ``boots`` counts the boots that were measured, None if one is not known. ``boots_known``
    counts the known ones, or is 1 if none is known. ``boards`` counts the boards that were measured. ``longest_burst``
    is the mean length of unseen bursts of misses up to which PROVEN would hold. It has to cover ``bursts``, which are
    ``bursts_by_default`` long unless the question asks otherwise; ``further_for_bursts`` gives (length, measurements
    without a miss that would cover it). ``episodes`` of misses are None where no order was kept.

    ``further`` measurements without another miss would give PROVEN (0: it is given, None: no number would);
    ``further_chance`` is the chance that no miss comes. ``further_likely`` is (answer, measurements): this many suffice
    nine times in ten if misses continue at the rate seen; None if no number does.

    ``runs`` counts the runs that are judged. ``lost`` has a sentence for each attempt that gave nothing to judge. To
    outweigh these, ``units_missing`` more units (``unit``: boots, or runs of one boot) have to end well; None if no
    number is enough. ``unseen_share`` is the share of an observation's time that was not seen, ``hidden_share`` the
    share not seen because of load, which counts as late; ``lower`` and ``upper`` include both. ``unlike`` is what may
    differ from everything that was measured, ``climbs`` are the climbs from boot to boot and from run to run that would
    have been seen. No number here includes ``startup``.
    """

    answer: Answer
    question: Question
    n: int
    late: int
    absent: int
    worst_ns: int | None
    p_miss: float
    lower: float
    upper: float
    design_effect: float
    n_effective: float
    boots: int | None
    boots_known: int
    boards: int
    bursts: Bursts
    bursts_by_default: int
    longest_burst: float
    further_for_bursts: tuple[tuple[int, int], ...]
    further: int | None
    further_chance: float
    further_likely: tuple[Answer, int] | None
    period_ns: float | None
    assumes: tuple[str, ...]
    runs: int
    lost: tuple[str, ...] = ()
    unit: Literal["boot", "run"] = "run"
    units_missing: int | None = 0
    unseen_share: float = 0.0
    hidden_share: float = 0.0
    unlike: tuple[Unlike, ...] = ()
    climbs: tuple[Climb, ...] = ()
    episodes: Episodes | None = None
    change: Change | None = None
    refused: str | None = None
    startup: LeftOut | None = None

    @property
    def misses(self) -> int:
        """Measurements that did not meet the deadline."""
        return self.late + self.absent

    @property
    def boots_missing(self) -> int:
        """How many more boots the question asks for."""
        return max(0, self.question.boots - self.boots_known)

    @property
    def decided_after(self) -> tuple[Answer, int] | None:
        """The answer to expect, and after how many more measurements. If no miss was seen, these are without a miss;
        otherwise they suffice nine times in ten at the rate seen. None if no number is likely to decide it.
        """
        if self.misses or self.further is None:
            return self.further_likely
        return Answer.PROVEN, self.further

    @property
    def unlike_boots(self) -> Unlike | None:
        """The boots in `unlike`; None where the boots are not known."""
        return next((unlike for unlike in self.unlike if unlike.unit == "boot"), None)

    def hours(self, measurements: int) -> float | None:
        """How long so many measurements take; None when the period is not known."""
        return None if self.period_ns is None else measurements * self.period_ns / 3.6e12


def judge(account: Account, question: Question) -> Verdict:
    """Answer a question from an account of the evidence.

    PROVEN: the interval's upper end is below the question's probability, and no run shows a change. IF_INDEPENDENT: the
    same, from counts that kept no order. REFUTED: the lower end is above it; after a change, so is that of the later
    half. Otherwise, and with fewer boots than requested: NEEDS MORE, with how many. A lost attempt counts as a unit (a
    boot, or a run of one boot) that was late throughout. So does the time that load hid from an observation, because
    the time that was seen is the lucky part. For a refutation, time that was not seen holds no miss. Numbers from an
    emulated board, or for a deadline below two clock steps, are no real-time statement. Raises ValueError when
    probability or confidence is not between 0 and 1.
    """
    probability, confidence = question.probability, question.confidence
    if not 0 < probability < 1 or not 0 < confidence < 1:
        raise ValueError("probability and confidence must lie between 0 and 1, both ends excluded")
    runs = sorted(account.runs, key=lambda run: run.start_time)
    late, absent = sum(run.late for run in runs), sum(run.absent for run in runs)
    alike = count_alike(runs)
    n, misses = math.floor(sum(run.n for run in alike)), sum(run.misses for run in alike)
    joined = join_boots(runs)
    constancy = examine_constancy(joined, probability=probability, confidence=confidence, deadline_ns=question.limit_ns)
    effect, assumes = _effect(runs, alike, constancy.clusters, question, account.measurements_per_event)
    boots = len(set(boots_of(runs)))
    confidence_above = of_few(confidence, boots)
    of_measured = _shared(confidence_above, account)
    upper = anytime_upper(misses / effect, n / effect, of_measured)
    surely = misses
    if unclear := sum(run.unclear for run in runs):
        # What may have met the deadline counts as late for a proof, and as in time for a refutation.
        surely = sum(counted.misses - counted.share * run.unclear for run, counted in zip(runs, alike, strict=True))
        assumes = (
            *assumes,
            f"{unclear} values within a step of the clock, or a bin of a log, of the deadline are late",
        )
    lower = anytime_lower(surely / effect, n / effect, _shared(confidence, account))
    is_constant = constancy.change is None
    late_share = _late_share(question, account)
    episodes = _episodes(runs, question, account, confidence_above)
    longest_seen = episodes.most_in_a_row if episodes else 1
    bursts = bursts_asked(question, account.stream_ns, longest_seen)
    per_event = account.measurements_per_event
    # Streams that are late together share a burst: each holds a part of it.
    asked = replace(
        question,
        bursts=bursts.length * per_event if bursts.length > 1 else 1,
        # Further measurements are expected on at least the requested number of boots.
        confidence=of_few(confidence, max(boots, question.boots)),
    )
    lower, upper = lower * (1 - account.unseen_share), min(1.0, upper + late_share)
    left = replace(question, probability=question.probability - late_share, confidence=of_measured)
    covered = longest_burst(misses, n, effect, left) / per_event if left.probability > 0 else 0.0
    covered = covered and max(1.0, covered)
    refused = _refusal(question, account)
    answer = Answer.NEEDS_MORE
    if refused:
        answer = Answer.NO_STATEMENT
    elif account.boots_known < question.boots:
        pass
    elif covered >= bursts.length and is_constant:
        is_ordered = all(run.misses is not None for run in runs)
        answer = Answer.PROVEN if is_ordered else Answer.IF_INDEPENDENT
    elif (
        n and lower > probability and (not constancy.in_time or _later_refutes(alike, effect, probability, confidence))
    ):
        answer = Answer.REFUTED
    is_whole = not late_share
    further = missing_without_miss(misses, n, effect, asked) if is_whole else None
    is_open = answer == Answer.NEEDS_MORE and is_constant and is_whole
    likely = likely_further(misses, n, effect, asked) if is_open else None
    is_proven = answer in (Answer.PROVEN, Answer.IF_INDEPENDENT)
    return Verdict(
        answer=answer,
        question=question,
        n=sum(run.n for run in runs),
        late=late,
        absent=absent,
        worst_ns=max((run.worst_ns for run in runs if run.worst_ns is not None), default=None),
        p_miss=misses / n if n else 0.0,
        lower=lower,
        upper=upper,
        design_effect=effect,
        n_effective=n / effect,
        boots=account.boots,
        boots_known=account.boots_known,
        boards=account.boards,
        bursts=bursts,
        bursts_by_default=bursts_asked(replace(question, bursts=None), account.stream_ns, longest_seen).length,
        longest_burst=covered,
        further_for_bursts=_further_for_bursts(misses, n, effect, asked, per_event) if is_proven else (),
        further=further,
        further_chance=chance_of_no_miss(misses, n, effect, further or 0),
        further_likely=likely and (Answer.PROVEN if likely[0] else Answer.REFUTED, likely[1]),
        period_ns=account.period_ns,
        assumes=assumes,
        runs=account.measured,
        lost=account.lost,
        unit=account.unit,
        units_missing=_units_missing(question, account),
        unseen_share=account.unseen_share,
        hidden_share=account.hidden_share,
        unlike=_unlike(account, question),
        climbs=find_climbs(joined, question.limit_ns),
        episodes=episodes,
        change=constancy.change,
        refused=refused,
        startup=account.startup,
    )


def _later_refutes(alike: Sequence[CountedRun], effect: float, probability: float, confidence: float) -> bool:
    """Whether the later half of the measurements refutes alone: a system that got better is no longer what it was."""
    half = sum(run.n for run in alike) / 2
    middles = np.cumsum([run.n for run in alike]) - [run.n / 2 for run in alike]
    later = [run for run, middle in zip(alike, middles, strict=True) if middle >= half]
    n, misses = sum(run.n for run in later), sum(run.misses for run in later)
    return anytime_lower(misses / effect, n / effect, confidence) > probability


def _unlike(account: Account, question: Question) -> tuple[Unlike, ...]:
    """What may differ from everything that was measured; also runs, if there is one boot or boots are not known."""
    if not account.measured:
        return ()
    short = shorter(account.runs, [run.board for run in account.runs])
    units: list[tuple[Literal["run", "boot", "board"], int, int]] = [("board", account.boards, short)]
    if account.boots is not None:
        units.insert(0, ("boot", account.boots, shorter(account.runs, boots_of(account.runs))))
    if account.boots is None or account.boots == 1:
        units.insert(0, ("run", account.measured, 0))
    found = [
        Unlike(unit=unit, measured=n, short=short, share=clopper_pearson(short, n, question.confidence)[1])
        for unit, n, short in units
    ]
    if account.hours is not None:
        found.append(Unlike(unit="hour", measured=account.hours, share=1 - account.hours / HOURS))
    return tuple(found)


def _shared(confidence: float, account: Account) -> float:
    """The confidence of each of two bounds that hold together: on the measurements, and on lost units."""
    return (1 + confidence) / 2 if account.lost else confidence


def _late_share(question: Question, account: Account) -> float:
    """The share of units that may be like the lost ones, plus that which load hid: all of it may have been late."""
    lost = len(account.lost)
    of_units = anytime_upper(lost, account.units + lost, _shared(question.confidence, account)) if lost else 0.0
    return min(1.0, of_units + account.hidden_share)


def _units_missing(question: Question, account: Account) -> int | None:
    """How many more units have to end well, so that half of the probability is left to the measurements."""
    lost = len(account.lost)
    most = question.probability / 2 - account.hidden_share
    if not lost:
        return 0
    if most <= 0:
        return None
    confidence = _shared(question.confidence, account)
    total = smallest(lambda clean: anytime_upper(lost, clean + lost, confidence) < most, max(1, account.units))
    return None if total is None else total - account.units


def _episodes(runs: Sequence[Trials], question: Question, account: Account, confidence: float) -> Episodes | None:
    """The episodes of misses. Like misses they are judged with the dependence between them.

    There is no bound if attempts were lost or load hid some time: these may hold any number of episodes.
    """
    found = [run.episodes for run in runs if run.episodes is not None]
    if len(found) < len(runs) or not found:
        return None
    begun = [
        replace(
            run, late=episodes.begun.count, absent=0, misses=episodes.begun, missed_at=episodes.begun_at, level=None
        )
        for run, episodes in zip(runs, found, strict=True)
    ]
    bound = None
    if account.stream_ns is not None and not account.lost and not account.hidden_share:
        alike = count_alike(begun)
        single = replace(question, tolerance=NONE_TOLERATED)
        effect, _ = _effect(begun, alike, (), single, account.measurements_per_event)
        n, count = sum(run.n for run in alike), sum(run.misses for run in alike)
        bound = per_hour(anytime_upper(count / effect, n / effect, confidence), account.stream_ns)
    longest_loops = max(episodes.longest_loops for episodes in found)
    return Episodes(
        seen=sum(episodes.begun.count for episodes in found),
        longest_misses=max(episodes.longest_misses for episodes in found),
        most_in_a_row=max(episodes.most_in_a_row for episodes in found),
        longest_ns=None if account.stream_ns is None else longest_loops * account.stream_ns,
        per_hour_at_most=bound,
    )


def _refusal(question: Question, account: Account) -> str | None:
    """Why numbers are no real-time statement; None if they are one."""
    if account.emulated:
        return "measured on an emulated board"
    step_ns = account.clock_step_ns
    if step_ns is not None and question.limit_ns < 2 * step_ns:
        return f"the deadline of {question.limit_ns} ns is finer than two steps of the clock ({step_ns} ns each)"
    return None


def _further_for_bursts(
    misses: float, n: int, effect: float, question: Question, per_event: int
) -> tuple[tuple[int, int], ...]:
    """(length of bursts, measurements without a miss that would cover them), for lengths that are not covered yet."""
    asked = [(length, replace(question, bursts=length * per_event)) for length in BURSTS]
    return tuple(
        (length, more) for length, longer in asked if (more := missing_without_miss(misses, n, effect, longer))
    )


def _effect(
    runs: Sequence[Trials],
    alike: Sequence[CountedRun],
    clusters: Sequence[Cluster],
    question: Question,
    per_event: int,
) -> tuple[float, tuple[str, ...]]:
    """The design effect (at most the number of measurements), and the assumptions that it needed."""
    of_runs, assumes = _effect_of_runs(runs, alike, question.confidence, per_event)
    of_clusters = _effect_of_clusters(clusters, question.confidence)
    effect = max(of_runs, of_clusters, _least_effect(question, per_event))
    return min(effect, max(1.0, sum(run.n for run in alike))), assumes


def _least_effect(question: Question, per_event: int) -> float:
    """The design effect that is known beforehand: subscribers of one message, and windows that hold the same misses."""
    return float(per_event * question.tolerance.overlap)


def _effect_of_runs(
    runs: Sequence[Trials], alike: Sequence[CountedRun], confidence: float, measurements_per_event: int
) -> tuple[float, tuple[str, ...]]:
    """The design effect of all runs, the largest of those within and between runs, and the assumptions that it
    needed."""
    between = _effect_between(runs, alike, confidence)
    located = [run.misses for run in runs if run.misses is not None]
    misses = sum(run.late + run.absent for run in runs)
    if len(located) < len(runs):
        return max(between, measurements_per_event), (
            "independent measurements: a log without samples keeps no order, bursts would not be seen",
        )
    if misses >= ENOUGH_MISSES:
        return max(measurements_per_event * _widened([pool(located)], confidence), between), ()
    starts = np.cumsum([0, *(run.n for run in runs)])
    places = [run.missed_at + start for run, start in zip(runs, starts, strict=False)]
    own = effect_of_few(np.concatenate(places), int(starts[-1])) if misses > 1 else 1.0
    levels = [run.level for run in runs if run.level is not None]
    assumes = () if levels else ("independent measurements: too few to see bursts",)
    # The highest values are a smaller share of a long run than of a short one.
    within = max(own, _widened(levels, confidence)) if levels else own
    return max(measurements_per_event * within, between), assumes


def _effect_between(runs: Sequence[Trials], alike: Sequence[CountedRun], confidence: float) -> float:
    """The larger design effect of boards and of boots; that of runs, if all are of one boot and differ beyond chance; 0
    if there is none.

    Few boots tell little about how boots differ: the effect is widened by (t/z)^2 with boots - 1 degrees of freedom
    (Korn & Graubard 1998), but not beyond what it would be if each boot's misses were one burst, 1 + misses / boots.
    The same holds for boards. Runs of an unknown boot count as a boot each.
    """
    boards, boots = ([*sums(alike, keys).values()] for keys in ([run.board for run in runs], boots_of(runs)))
    if len(boots) > 1:
        return max(_effect_of_clusters(clusters, confidence) for clusters in (boards, boots))
    clusters = [*sums(alike, [run.run or str(index) for index, run in enumerate(runs)]).values()]
    effect = cluster_effect(clusters)
    if len(clusters) < 2 or chi_squared_above((len(clusters) - 1) * effect, len(clusters) - 1) > SIGNIFICANT:
        return 0.0
    return effect * _few(len(clusters) - 1, confidence)


def _effect_of_clusters(clusters: Sequence[Cluster], confidence: float) -> float:
    """The design effect of clusters, widened. Their effective number takes unequal lengths into account (Kish 1965)."""
    clusters = [cluster for cluster in clusters if cluster[0]]
    misses = sum(events for _, events in clusters)
    if len(clusters) < 2 or not misses:
        return 0.0
    effect = cluster_effect(clusters)
    count = sum(n for n, _ in clusters) ** 2 / sum(n * n for n, _ in clusters)
    return max(effect, min(effect * _few(max(1.0, count - 1), confidence), 1 + misses / count))


def _few(degrees: float, confidence: float) -> float:
    """The squared ratio of Student's t to the normal quantile (Korn & Graubard 1998)."""
    middle = (1 + confidence) / 2
    return (student_quantile(middle, degrees) / normal_quantile(middle)) ** 2


def _widened(parts: Sequence[Events], confidence: float) -> float:
    """The design effect, enlarged if it rests on few bursts: their number counts as degrees of freedom.

    It never exceeds what it would be if all events were one burst.
    """
    effect, count = design_effect(*parts), sum(part.count for part in parts)
    if effect == 1:
        return 1.0
    return max(effect, min(effect * _few(max(1.0, count / effect), confidence), float(count)))
