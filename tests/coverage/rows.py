"""What is simulated: how often a verdict is wrong, a row for every kind of data, with the share that is allowed.

P(miss) is the target itself, but for a millionth part, so that every PROVEN is one too many. Data are not chosen to
suit the method: nothing in a sample but the misses hints at bursts, boots or a change.
"""

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

import late_values
import null_campaigns
import numpy as np
import processes
from processes import DEADLINE_NS, Int64s, Lengths, Rng
from report.campaigns import cyclic_rows
from scipy.signal import lfilter
from scipy.stats import genpareto
from written import write_output

from rtrun.analysis import deadline
from rtrun.analysis.account import Account
from rtrun.analysis.chance.distributions import Floats
from rtrun.analysis.chance.further import proves, smallest
from rtrun.analysis.chance.intervals import anytime_interval, anytime_upper, clopper_pearson
from rtrun.analysis.comparison import differences as comparison
from rtrun.analysis.comparison import layers
from rtrun.analysis.comparison.differences import ComparisonAnswer, compare, correct
from rtrun.analysis.comparison.layers import attribute
from rtrun.analysis.deadline import Answer, Unlike, Verdict, judge
from rtrun.analysis.dependence.blocks import Blocks, cut
from rtrun.analysis.dependence.episodes import FoundEpisodes
from rtrun.analysis.dependence.units import CountedRun
from rtrun.analysis.histogram import from_samples
from rtrun.analysis.order import constancy, recurrence, startup
from rtrun.analysis.order.constancy import Boot, Constancy, examine_constancy, join_boots
from rtrun.analysis.order.stationarity import SIGNIFICANT, Change, find_change
from rtrun.analysis.order.trends import find_climb
from rtrun.analysis.tails.anderson_darling import p_value
from rtrun.analysis.tails.extreme_values import tail_of
from rtrun.analysis.tails.fits import GPD, fit, sample_of
from rtrun.analysis.tails.worst_case import worst_case
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram
from rtrun.judgement import study as studies
from rtrun.judgement.study import study
from rtrun.kinds.lateness import Of
from rtrun.plan import question as questions
from rtrun.plan.question import THESIS, Bursts, Question, Tolerance, read_tolerance
from rtrun.results.journal import open_journal
from rtrun.results.record import RunStatus
from rtrun.results.run_state import GivenUp, RunState
from rtrun.results.series import SampleSeries, read_file

SEED = 20140715
P = 1e-3
Draw = Callable[[Rng], bool | None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A kind of data, and an event whose share over many draws must be at most (at least) so much, in percent.

    A draw is True where the event happened, None where it does not count. ``today`` is the share before these remedies
    as it was reported, ``remedy`` the function without which the quick bound must fail: its module, its name and what
    stands in for it.
    """

    name: str
    draw: Draw
    event: str = "PROVEN"
    at_most: float = 100.0
    at_least: float = 0.0
    quick: int = 120
    long: int = 500
    reported: str = ""
    remedy: tuple[ModuleType | type, str, object] | None = None

    def events(self, draws: int, part: int = 0) -> tuple[int, int]:
        """In how many of so many draws the event happened, and how many of them count; each part has its own seed."""
        rng = np.random.default_rng([SEED, part])
        counted = [happened for _ in range(draws) if (happened := self.draw(rng)) is not None]
        return sum(counted), len(counted)

    def is_broken(self, draws: int) -> bool:
        """Whether the share of so many draws is beyond the bounds; no more are made than it takes to know that."""
        rng, happened, counted = np.random.default_rng([SEED, 0]), 0, 0
        for left in reversed(range(draws)):
            drawn = self.draw(rng)
            happened, counted = happened + bool(drawn), counted + (drawn is not None)
            lowest, highest = percent(happened, counted + left), percent(happened + left, counted + left)
            if lowest > self.at_most or highest < self.at_least:
                return True
        return False

    def holds(self, share: float) -> bool:
        """Whether a share is within the bounds."""
        return self.at_least <= share <= self.at_most


def percent(events: int, counted: int) -> float:
    """The share of events among the draws that count."""
    return 100 * events / max(1, counted)


def trials_of(values: Int64s, number: int, boot: str) -> Trials:
    return replace(count_misses(values, DEADLINE_NS), run=str(number), boot=boot, start_time=f"{number:04d}")


QUESTION = Question(deadline_ns=DEADLINE_NS, probability=P * (1 - 1e-6), bursts=1)


def judged(trials: Sequence[Trials], question: Question = QUESTION) -> Verdict:
    """The verdict without its forecast, which no answer rests on, and which takes most of the time."""
    with patch.object(deadline, "likely_further", lambda *_: None):
        return judge(Account(trials), question)


def verdict_on(runs: Sequence[Int64s], *, one_boot: bool = True) -> Verdict:
    """The verdict on runs of one boot, or of a boot each."""
    return judged([trials_of(values, k, "boot" if one_boot else str(k)) for k, values in enumerate(runs)])


def after_startup(runs: Sequence[Int64s]) -> tuple[Verdict, bool]:
    """The verdict on what follows the start-up of runs of one boot, and whether there is one."""
    none = np.empty(0, np.int64)
    found = startup.find_startup([[startup.head_of(values, none, DEADLINE_NS)] for values in runs])
    kept = runs if found is None else [startup.split(values, none, DEADLINE_NS, found.loops)[1] for values in runs]
    trials = [trials_of(values, k, "boot") for k, values in enumerate(kept)]
    return judged(trials, replace(QUESTION, bursts=1)), found is not None


def startup_found(number: int, make: Callable[[Rng], Int64s], rng: Rng) -> bool:
    """Whether a start-up is left out of so many runs."""
    return after_startup([make(rng) for _ in range(number)])[1]


def proven_after_startup(number: int, make: Callable[[Rng], Int64s], rng: Rng, length: int = 1) -> bool:
    """PROVEN of what follows a start-up, which is reported; and said to hold for bursts of this length."""
    verdict, is_found = after_startup([make(rng) for _ in range(number)])
    return verdict.answer == Answer.PROVEN and is_found and verdict.longest_burst >= length


def proven(make: Callable[[Rng], Int64s], rng: Rng) -> bool:
    return verdict_on([make(rng)]).answer == Answer.PROVEN


def proven_of_boots(number: int, n: int, rng: Rng) -> bool:
    runs = processes.boots(number, n, P, rng, spread=0.5)
    return verdict_on(runs, one_boot=False).answer == Answer.PROVEN


def wrong_of_unlike_boots(answer: Answer, lengths: Sequence[int], sd: float, rng: Rng) -> bool:
    """This answer from boots of these lengths, whose rates are lognormal with the mean P.

    P is a millionth below (PROVEN) or above the target.
    """
    rates = P * np.exp(rng.normal(-(sd**2) / 2, sd, len(lengths)))
    runs = [processes.independent(n, min(1.0, rate), rng) for n, rate in zip(lengths, rates, strict=True)]
    question = QUESTION if answer is Answer.PROVEN else replace(QUESTION, probability=P * (1 + 1e-6))
    return judged([trials_of(values, k, str(k)) for k, values in enumerate(runs)], question).answer == answer


def proven_of_some_bad_boots(number: int, scope: float, rng: Rng) -> bool:
    """PROVEN, and said to speak for all boots but this share."""
    verdict = verdict_on(processes.some_bad_boots(number, 4000, P, rng, one_in=20), one_boot=False)
    return _is_said_to_hold_for_all_but(scope, verdict)


def proven_of_short_bad_boots(number: int, share: float, longer: int, rng: Rng) -> bool:
    """PROVEN, and said to speak for all boots but fewer than the bad ones, which have all misses and end early."""
    is_bad = rng.random(number) < share
    runs = [processes.independent(200, P / share, rng) if bad else processes.quiet(longer * 200, rng) for bad in is_bad]
    return _is_said_to_hold_for_all_but(share, verdict_on(runs, one_boot=False))


def _is_said_to_hold_for_all_but(share: float, verdict: Verdict) -> bool:
    unlike = verdict.unlike_boots
    return verdict.answer == Answer.PROVEN and unlike is not None and unlike.share <= share


def proven_of_fractional_noise(number: int, rng: Rng) -> bool:
    runs = [processes.fractional(100_000 // number, P, rng, hurst=0.9) for _ in range(number)]
    return verdict_on(runs, one_boot=False).answer == Answer.PROVEN


def some_group_differs(rng: Rng) -> bool:
    """Whether any of twelve groups, five runs a side measured in turn, is called DIFFERENT; runs differ by 1 us."""
    compared = []
    for _ in range(12):
        runs = [
            replace(
                cut((1000 * (86 + rng.normal() + rng.gamma(4.0, 4.0, 1000))).astype(np.int64)), start_time=f"{k:02}"
            )
            for k in range(10)
        ]
        compared.append(compare(runs[::2], runs[1::2], tests=12))
    return any(one.answer is ComparisonAnswer.DIFFERENT for one in correct(compared))


def proven_for(length: float, n: int, rng: Rng) -> bool:
    """PROVEN, and said to hold for bursts of this length."""
    verdict = verdict_on([processes.bursts(n, P, rng, length=length)])
    return verdict.answer == Answer.PROVEN and verdict.longest_burst >= length


def verdict_at_1_khz(runs: Sequence[Int64s], *, one_boot: bool = True) -> Verdict:
    """The verdict on runs of one boot, or of a boot each, of a stream at 1 kHz, with the bursts of the default."""
    trials = [
        replace(trials_of(values, k, "boot" if one_boot else str(k)), episodes=_episodes_at_1_khz(values))
        for k, values in enumerate(runs)
    ]
    with patch.object(deadline, "likely_further", lambda *_: None):
        return judge(Account(trials, period_ns=1e6), replace(QUESTION, bursts=None))


def _episodes_at_1_khz(values: Int64s) -> FoundEpisodes | None:
    return count_misses(values, DEADLINE_NS, period_ns=1e6).episodes


def proven_at_1_khz(make: Callable[[Rng], Int64s], rng: Rng) -> bool:
    return verdict_at_1_khz([make(rng)]).answer == Answer.PROVEN


def come_more_often_than_stated(lengths: Lengths, rate: float, n: int, looks: int, rng: Rng) -> bool:
    """Whether at any look after a run of n loops the bound on episodes an hour is below the truth."""
    runs: list[Int64s] = []
    for _ in range(looks):
        runs.append(processes.episodes(n, rate, rng, lengths=lengths))
        if _is_too_low(verdict_at_1_khz(runs), rate):
            return True
    return False


def come_more_often_than_stated_of_boots(number: int, sd: float, rng: Rng) -> bool:
    """The same of boots, whose rates of episodes are lognormal."""
    rate = 1 / 2000
    rates = rate * np.exp(rng.normal(-(sd**2) / 2, sd, number))
    lengths = processes.LENGTHS["always 10"]
    runs = [processes.episodes(40_000, min(each, 1 / 30), rng, lengths=lengths) for each in rates]
    return _is_too_low(verdict_at_1_khz(runs, one_boot=False), rate)


def _is_too_low(verdict: Verdict, rate: float) -> bool:
    assert verdict.episodes is not None and verdict.episodes.per_hour_at_most is not None
    return verdict.episodes.per_hour_at_most < 3.6e6 * rate


def proven_at_any_look(looks: int, n: int, rng: Rng) -> bool:
    """PROVEN after any of so many batches."""
    batches: list[Trials] = []
    for look in range(looks):
        batches.append(trials_of(processes.independent(n, P, rng), look, "boot"))
        if judged(batches).answer == Answer.PROVEN:
            return True
    return False


def proven_in_pieces(number: int, n: int, rates: Callable[[int], float], one_boot: bool, rng: Rng) -> bool:
    runs = processes.regimes(number, n, rates, rng)
    return verdict_on(runs, one_boot=one_boot).answer == Answer.PROVEN


def decided(memory: float, answer: Answer, boots: int, rng: Rng) -> bool:
    """This answer of AR data at a tenth of P, or at ten times P, on so many boots.

    There are twice as many as of independent data decide 95 times in 100, in effective numbers: an autoregressive
    process of n values is worth n (1 - memory) / (1 + memory).
    """
    of_boots = {1: 12_800, 5: 30_000}
    rate, enough = (P / 10, of_boots[boots]) if answer is Answer.PROVEN else (10 * P, 3700)
    n = round(2 * enough * (1 + memory) / (1 - memory)) // boots
    runs = [processes.autoregressive(n, rate, rng, memory=memory) for _ in range(boots)]
    return verdict_on(runs, one_boot=boots == 1).answer == answer


def proven_of_climbing_boots(step_us: float, rng: Rng) -> bool:
    """PROVEN from ten boots, each slower than the last, the last one just below the deadline."""
    runs = [processes.around(394_000 - 1000 * step_us * (9 - boot), 2000, rng) for boot in range(10)]
    return verdict_on(runs, one_boot=False).answer == Answer.PROVEN


def proven_of_leaks(boots: int, each: int, rng: Rng) -> bool:
    """PROVEN from runs within each of which values climb from 100 to 380 us: the process restarts for each."""
    runs = [processes.around(np.linspace(100_000, 380_000, 5000), 5000, rng) for _ in range(boots * each)]
    trials = [trials_of(values, k, str(k // each)) for k, values in enumerate(runs)]
    return judged(trials).answer == Answer.PROVEN


def changes_in_what_stays_the_same(process: processes.Process, runs: int, boots: int, rng: Rng) -> bool:
    """A change is seen in runs of boots that are lognormal (sd 0.3) at a tenth of P, where the order means nothing."""
    rates = P / 10 * np.exp(rng.normal(-0.045, 0.3, boots))
    trials = [trials_of(process(4000, rates[k * boots // runs], rng), k, str(k * boots // runs)) for k in range(runs)]
    return judged(trials).change is not None


def proven_in_rounds(turns: int, rate: float, regular: bool, rng: Rng) -> bool:
    """PROVEN from twenty runs of one boot, beside a load that comes and goes."""
    turn = 100_000
    values = processes.slow_load(2 * turn * turns, rate, rng, turn=turn, regular=regular)
    return verdict_on(np.array_split(values, 20)).answer == Answer.PROVEN


def changes_under_the_slowest_load(n: int, rng: Rng) -> bool:
    """A change is seen in runs that are as long as the plan says that a load needs, which is there half of the time."""
    turn = round(constancy.slowest_load(n) / 2)
    values = processes.slow_load(n, P / 10, rng, turn=turn)
    return verdict_on(np.array_split(values, 10)).change is not None


def proven_at_any_look_in_bursts(length: int, rng: Rng) -> bool:
    """PROVEN after any round of a goal that asks for bursts of this length; a refutation ends it, too."""
    question = replace(QUESTION, bursts=length)
    batches: list[Trials] = []
    for look in range(40):
        values = processes.bursts(250 * length, P, rng, length=float(length))
        batches.append(trials_of(values, look, "boot"))
        answer = judged(batches, question).answer
        if answer in (Answer.PROVEN, Answer.REFUTED):
            return answer == Answer.PROVEN
    return False


def proven_at_any_look_in_boots(spread: float, rng: Rng) -> bool:
    """PROVEN after any of thirty boots, from five on, whose rates are lognormal with the mean P."""
    rates = P * np.exp(rng.normal(-(spread**2) / 2, spread, 30))
    boots: list[Trials] = []
    for look, rate in enumerate(rates):
        boots.append(trials_of(processes.independent(4000, min(1.0, rate), rng), look, str(look)))
        if look >= 4 and judged(boots).answer == Answer.PROVEN:
            return True
    return False


@cache
def _proofs(probability: float, n: int) -> Int64s:
    """From how many measurements on 0, 1, 2, ... 199 misses prove P(miss) below the target, (k,), up to n."""
    question, proofs = replace(THESIS, probability=probability, bursts=1), [1]
    while proofs[-1] <= n and len(proofs) <= 200:
        proofs.append(smallest(lambda total: proves(len(proofs) - 1, total, 1.0, question), proofs[-1]) or n + 1)
    return np.array(proofs[1:], np.int64)


def proven_after_a_change_of_goal(rng: Rng) -> bool:
    """PROVEN wrongly at any look, whoever may change the goal to any of fourteen, each at its true P(miss)."""
    n = 60_000
    goals = [Question(deadline_ns=1000 + number, probability=0.5 / 1.6**number, bursts=1) for number in range(14)]
    values = rng.random(n)
    for goal in goals:
        if questions.may_follow(goals[7], goal):
            misses = np.flatnonzero(values < goal.probability) + 1
            proofs = _proofs(goal.probability, n)[: misses.size]
            if np.any(proofs < misses[: proofs.size]):
                return True
    return False


def outside_the_interval(order: str, rng: Rng) -> bool | None:
    """Whether what a layer adds lies outside its interval; runs drift by half their standard deviation each.

    `order` is that of the runs of both layers (L, U), drawn anew where it is empty. None where it is refused.
    """
    runs: dict[str, list[Blocks]] = {"L": [], "U": []}
    for place, layer in enumerate(order or rng.permutation([*"LLLLLLLLUUUUUUUU"])):
        mean_ns = 40_000 + 500 * place + 1000 * rng.normal() + (30_000 if layer == "U" else 0)
        block = cut(np.full(2, round(mean_ns)))
        runs[str(layer)].append(replace(block, start_time=f"2026-01-01T00:{place:02}:00+00:00"))
    layers = attribute(runs["L"], runs["U"])
    if layers.refused:
        return None
    added = layers.added[0]
    return not added.low <= 30_000 <= added.high


def _in_pairs(values: tuple[Floats, Floats], _: object) -> tuple[float, float, float]:
    """As if a drift cancelled in pairs of runs."""
    gaps = values[1] - values[0]
    return float(gaps.mean()), float(gaps.std(ddof=1)) / gaps.size**0.5, gaps.size - 1.0


def seen_to_differ(rng: Rng) -> bool:
    """DIFFERENT, of two sets of twenty runs that differ in nothing, most of the first one before the second one."""
    sides: dict[str, list[Blocks]] = {"A": [], "B": []}
    for place, side in enumerate(5 * "A" + 15 * "AB" + 5 * "B"):
        block = cut(rng.normal(40_000 + 500 * place + 1000 * rng.normal(), 2000, 128).astype(np.int64))
        sides[side].append(replace(block, boot="boot", start_time=f"2026-01-01T00:{place:02}:00+00:00"))
    return compare(sides["A"], sides["B"]).answer == ComparisonAnswer.DIFFERENT


def _remembering(n: int, mean_ns: float, rng: Rng) -> Blocks:
    """A run of AR(0.95) values with a standard deviation of 8 us."""
    noise = rng.normal(size=n + 500) * (1 - 0.95**2) ** 0.5
    return cut((mean_ns + 8000 * lfilter([1], [1, -0.95], noise)[500:]).astype(np.int64))


def run_seen_to_differ(shift_ns: int, rng: Rng) -> bool:
    """Whether a run is seen to differ from one that lies so much higher."""
    compared = compare([_remembering(20_000, 60_000, rng)], [_remembering(20_000, 60_000 + shift_ns, rng)])
    return compared.answer == ComparisonAnswer.RUNS_DIFFER


def shift_outside_its_interval(rng: Rng) -> bool:
    """Whether a shift of 3 us lies outside the interval of the difference of means."""
    shift = compare([_remembering(20_000, 60_000, rng)], [_remembering(20_000, 63_000, rng)]).shifts[0]
    return not shift.low_ns <= 3000 <= shift.high_ns


def quantile_outside_its_interval(figure: str, rng: Rng) -> bool:
    """Whether a shift of 0.7 us of independent values lies outside the interval of this quantile's difference."""
    a, b = (cut((100_000 + shift + rng.normal(0, 4000, 40_000)).astype(np.int64)) for shift in (0, 700))
    (found,) = (shift for shift in compare([a], [b]).shifts if shift.figure == figure)
    return not found.low_ns <= 700 <= found.high_ns


def boots_seen_to_differ(rng: Rng) -> bool:
    """DIFFERENT, of two sets of six runs in turn, whose means differ by 1.5 us (standard deviation) and not by set."""
    runs = [
        replace(_remembering(4000, 60_000 + 1500 * rng.normal(), rng), boot="boot", start_time=f"{place:02}")
        for place in range(12)
    ]
    return compare(runs[::2], runs[1::2]).answer == ComparisonAnswer.DIFFERENT


def _slower_boots(slope_us: float, rng: Rng) -> list[Trials]:
    """Ten boots about 300 us (standard deviation 5 us), each so much slower than the last."""
    middles = [1000 * (300 + 5 * rng.normal() + slope_us * boot) for boot in range(10)]
    return [trials_of(processes.around(middle, 2000, rng), boot, str(boot)) for boot, middle in enumerate(middles)]


@cache
def _smallest_climb_us() -> float:
    """What is stated as the smallest climb that would be seen in such boots: the median of twenty sets of them."""
    rng = np.random.default_rng(SEED)
    climbs = [find_climb("boot", [[[run] for run in _slower_boots(0, rng)]], DEADLINE_NS) for _ in range(20)]
    return float(np.median([climb.smallest_ns for climb in climbs if climb and climb.smallest_ns])) / 1000


def climb_is_seen(part: float, rng: Rng) -> bool:
    """Whether a climb is seen that is such a part of the smallest one."""
    boots = join_boots(_slower_boots(part * _smallest_climb_us(), rng))
    return examine_constancy(boots, probability=P, confidence=0.95, deadline_ns=DEADLINE_NS).change is not None


def even_events_change(number: int, rng: Rng) -> bool:
    """Whether a change is seen in events that lie evenly."""
    change = find_change(np.sort(rng.choice(100_000, number, replace=False)), 100_000, "misses")
    return change is not None and change.p_value < SIGNIFICANT


def outside_at_any_look(rng: Rng) -> bool:
    """Whether the interval is without the true P(miss) after any measurement until 300 missed."""
    p, misses = 1e-2, rng.geometric(1e-2, 300).cumsum().tolist()
    is_proven = any(anytime_interval(k, n - 1, 0.95)[1] < p for k, n in enumerate(misses))
    return is_proven or any(anytime_interval(k, n, 0.95)[0] > p for k, n in enumerate(misses, 1))


def worst_cases(step_ns: int, rng: Rng) -> list[bool | None]:
    """Of each opinion on an exponential tail whether its interval misses the true level; None where it is refused."""
    truth = 50_000 - 5000 * np.log(1e-6)
    values = (50_000 + rng.exponential(5000, 200_000)).astype(np.int64) // step_ns * step_ns
    return [
        None if bound.low_ns is None or bound.high_ns is None else not bound.low_ns <= truth <= bound.high_ns
        for bound in worst_case([tail_of(values)], probability=1e-6, quantum_ns=step_ns)
    ]


def fit_is_rejected(level: float, shape: float, step_ns: int, rng: Rng) -> bool:
    """Whether a GPD that is fitted to values of a GPD is rejected at this level."""
    values = genpareto.rvs(shape, scale=5000, size=400, random_state=rng).astype(np.int64) // step_ns * step_ns
    return p_value(values, step_ns, fit(GPD, sample_of(values, step_ns))[0]) < level


def proven_by_those_that_did_not_hang(rng: Rng) -> bool:
    """PROVEN after forty runs, each repeated until it does not hang.

    A run that hangs is late to its end; so many hang that this alone is P(miss).
    """
    hangs, question = 0.1, replace(QUESTION, probability=0.1 * (1 - 1e-6))
    runs: list[Trials] = []
    lost: list[str] = []
    for number in range(40):
        lost += ["hung"] * (int(rng.geometric(1 - hangs)) - 1)
        runs.append(trials_of(processes.quiet(500, rng), number, "boot"))
    return judge(Account(runs, lost=tuple(lost)), question).answer == Answer.PROVEN


def proven_by_lucky_runs(rng: Rng) -> bool:
    """PROVEN from runs in which a publisher kept its rate, each repeated until it did.

    In one attempt of two something keeps it from that, and deadlines are missed twenty times as often. Of half of these
    attempts, which the runner ended, nothing but a line in the journal is left.
    """
    is_ended = bool(rng.integers(2))
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.closing(open_journal(Path(folder), "campaign", "1:plan", "board")) as journal,
    ):
        for number in range(2):
            attempts = 1 + int(rng.integers(1, 3))
            for attempt in range(attempts):
                is_last = attempt == attempts - 1
                values = processes.independent(5000, P / 10 if is_last else 2 * P, rng)
                journal.note("", f"{number}", RunState.LAUNCHING)
                if is_ended and not is_last:
                    journal.note("", f"{number}", RunState.PLANNED, GivenUp.TOO_LONG)
                    continue
                name = f"{number}" if is_last else f"{number}.old-{attempt}"
                null_campaigns.write_sent(Path(folder), name, values, is_kept=is_last)
                journal.note("", f"{number}", RunState.CLOSED, RunStatus.OK if is_last else RunStatus.INVALID)
        question = Question(deadline_ns=DEADLINE_NS, probability=P, bursts=1)
        return any(
            group.verdict is not None and group.verdict.answer == Answer.PROVEN
            for group in study(Path(folder), question, bounds=False).groups
        )


def proven_without_order(rng: Rng) -> bool:
    histogram = from_samples(processes.bursts(20_000, P, rng, length=5))
    trials = [count_misses_in_histogram(histogram, DEADLINE_NS)]
    return judged(trials, replace(QUESTION, probability=P)).answer == Answer.PROVEN


TWO_IN_A_ROW, THREE_OF_100 = read_tolerance("2 in a row"), read_tolerance("3 of 100")


def proven_with_some_tolerated(make: Callable[[Rng], Int64s], tolerance: Tolerance, rng: Rng) -> bool:
    trials = replace(count_misses(make(rng), DEADLINE_NS, tolerance=tolerance), boot="boot")
    return judged([trials], replace(QUESTION, tolerance=tolerance)).answer == Answer.PROVEN


def proven_of_a_timer(of: Of, rng: Rng) -> bool:
    """PROVEN from the samples of a cyclic timer that is ten times in a row late by the same, in P of its calls."""
    lateness = processes.clumps(50_000, P / 10, rng, size=10)
    requested = {"frequency_hz": 1000}
    with tempfile.TemporaryDirectory() as folder:
        path = write_output(
            Path(folder),
            "c",
            "cyclic_timer_tests",
            cyclic_rows(lateness, 1000),
            requested=requested,
            asked=lateness.size,
            measured=lateness.size,
        )
        (series,) = (one for one in read_file(path, of) if one.header.main)
        assert isinstance(series, SampleSeries)
        return verdict_on([series.values_ns]).answer == Answer.PROVEN


def enough(process: processes.Process, rate: float, as_seen: bool, rng: Rng) -> bool | None:
    """Whether the number reported as likely enough was; None where none was reported, or one too long to simulate.

    `as_seen`: misses go on at the rate that was seen, as the sentence has it; else at the true one.
    """
    n = 20_000
    first = process(n, rate, rng)
    further_likely = judge(Account([trials_of(first, 0, "boot")]), QUESTION).further_likely
    if further_likely is None or further_likely[0] != Answer.PROVEN or further_likely[1] > 3_000_000:
        return None
    seen = float(np.mean(first > QUESTION.deadline_ns))
    whole = process(n + further_likely[1], seen if as_seen else rate, rng)
    whole[:n] = first
    return verdict_on([whole]).answer == Answer.PROVEN


def as_measured(runs: Sequence[Trials]) -> list[CountedRun]:
    """As if the longest boot were the mean."""
    return [CountedRun(n=run.n, misses=run.late + run.absent) for run in runs]


def _never_between(*_: object) -> float:
    return 0.0


def _no_changes(*_: object, **__: object) -> Iterator[Change]:
    return iter(())


_UNEXAMINED = (deadline, "examine_constancy", lambda *_, **__: Constancy(change=None))


def _each_event(events: Int64s, frequency: float) -> Int64s:
    """The phases of events as if those of one period did not depend on each other."""
    vectors = np.exp(2j * np.pi * frequency * events)
    return np.angle(vectors * np.conj(vectors.sum())) / (2 * np.pi)


def _late(first: int, times: float) -> Callable[[int], float]:
    """So many times P from a run on, and a tenth of it before."""
    return lambda run: P * (times if run >= first else 0.1)


def _run_by_run(boots: Sequence[Boot], **question: float) -> Constancy:
    """As if each run were on its own: a slow load is a change in most of them."""
    runs = [replace(run, boot=run.run) for boot in boots for run in boot.trials]
    return examine_constancy(join_boots(runs), **question)


def _plain_interval(misses: float, n: float, effect: float, question: Question) -> float:
    """As if there were one look."""
    upper = clopper_pearson(misses / effect, n / effect, question.confidence)[1]
    return 1.0 if upper < question.probability else 0.0


def _singly(*_: object) -> Bursts:
    """As if a stall were a miss."""
    return Bursts(length=1, why="asked")


def _one_look(k: float, n: float, confidence: float) -> float:
    return clopper_pearson(k, n, 2 * confidence - 1)[1]


def _any_burst(misses: float, n: float, effect: float, question: Question) -> float:
    """As if bursts that were not seen were none."""
    return 1e9 if anytime_upper(misses / effect, n / effect, question.confidence) < question.probability else 0.0


ROWS = [
    *(
        Row(
            name=f"{name}, n = {n:.0e}", draw=partial(proven, partial(process, n, P)), at_most=5.0,
            quick=60 if n == 20_000 or name == "AR(0.95)" else 0,
            remedy=(deadline, "_widened", lambda *_: 1.0) if name == "AR(0.95)" and n == 100_000 else None,
        )
        for name, process in processes.DEPENDENT.items()
        for n in (20_000, 100_000)
    ),
    *(
        Row(
            name=f"{number} boots, a run each, rates lognormal (sd 0.5), n = {n:.0e}",
            draw=partial(proven_of_boots, number, n), at_most=7.0 if number < 5 else 5.0,
            quick=60 if n == 200_000 else 0, reported={2: "38", 3: "36", 5: "30", 7: "26"}.get(number, ""),
            remedy=(deadline, "_effect_between", _never_between) if n == 200_000 and number == 2 else None,
        )
        for number in (2, 3, 4, 5, 7, 10)
        for n in (20_000, 200_000)
    ),
    *(
        Row(
            name=f"{number} boots of {n / number:.0f} loops, rates lognormal (sd 1)",
            draw=partial(wrong_of_unlike_boots, Answer.PROVEN, [round(n / number)] * number, 1.0),
            at_most=8.0 if number in (3, 4) and n == 4_400 else 5.0, reported={2: "8.7", 5: "6.1"}.get(number, ""),
            quick=100 if n == 4_400 and number in (2, 5) else 0, long=1000,
            remedy=(deadline, "of_few", lambda confidence, _: confidence) if n == 4_400 and number == 2 else None,
        )
        for number in (2, 3, 4, 5, 7)
        for n in (4_400, 20_000, 200_000)
    ),
    Row(
        name="bursts of 5, n = 1e4 (none seen: 13.5 %)",
        draw=partial(proven, partial(processes.bursts, 10_000, P, length=5.0)), reported="25", quick=0,
    ),
    Row(
        name="bursts of 5, n = 2e4 (none seen: 1.8 %)",
        draw=partial(proven, partial(processes.bursts, 20_000, P, length=5.0)), at_most=12.0, quick=100,
        remedy=(deadline, "effect_of_few", lambda *_: 1.0),
    ),
    Row(
        name="bursts of 5, n = 5e4", draw=partial(proven, partial(processes.bursts, 50_000, P, length=5.0)),
        at_most=5.0, quick=60,
    ),
    *(
        Row(
            name=f"bursts of {length}, n = {n:.0e}", event=f"PROVEN and said to hold for bursts of {length}",
            draw=partial(proven_for, length, n), at_most=5.0, reported="80" if length >= 20 else "25",
            quick=80 if n == 20_000 else 0,
        )
        for length in (5, 20, 50)
        for n in (10_000, 20_000, 100_000)
    ),
    *(
        Row(
            name=f"looking after each of {looks} batches of 2000", event="PROVEN at any look",
            draw=partial(proven_at_any_look, looks, 2000), at_most=5.0, quick={20: 20}.get(looks, 0),
            long={1: 500, 5: 500, 20: 200, 100: 60}[looks], reported={1: "2", 5: "6", 20: "10", 100: "17"}[looks],
            remedy=(deadline, "longest_burst", _plain_interval) if looks == 20 else None,
        )
        for looks in (1, 5, 20, 100)
    ),
    *(
        Row(
            name=f"P = 5e-3 in the last 5 % only, n = {n:.0e}{note}",
            draw=partial(proven, partial(processes.late_regime, n, p=5e-3, part=0.05)), at_most=at_most,
            quick=100 if n == 20_000 else 0, reported="32" if n == 10_000 else "",
        )
        for n, at_most, note in (
            (10_000, 100.0, " (at most one miss: 28.7 %)"),
            (20_000, 8.0, " (at most one miss: 4.0 %)"),
            (100_000, 1.0, ""),
        )
    ),
    Row(
        name="values rise by half during the run, n = 1e5, no miss yet",
        draw=partial(proven, partial(processes.rising, 100_000)), at_most=5.0, quick=60, remedy=_UNEXAMINED,
    ),
    *(
        Row(
            name=f"ten boots, each {step:g} us slower than the last, which ends at 394 of 400 us",
            draw=partial(proven_of_climbing_boots, step), at_most=5.0, quick=20 if step == 25 else 0,
            reported="100" if step == 25 else "", remedy=(constancy, "changes_between", _no_changes),
        )
        for step in (1, 25, 40)
    ),
    *(
        Row(
            name=f"a leak within each run, {boots * each} runs on {boots} boots, from 100 to 380 of 400 us",
            draw=partial(proven_of_leaks, boots, each), at_most=5.0, quick=20 if each == 5 else 0, long=200,
            reported="100" if each == 5 else "",
        )
        for boots, each in ((6, 5), (1, 30), (30, 1))
    ),
    *(
        Row(
            name=f"{name}, {runs} runs on {boots} boots, a tenth of P", event="a change is seen",
            draw=partial(changes_in_what_stays_the_same, processes.DEPENDENT[name], runs, boots), at_most=12.0,
            quick=60 if name == "independent" and boots == 5 else 0, long=400,
        )
        for name in ("independent", "AR(0.9)", "load that comes and goes")
        for runs, boots in ((1, 1), (10, 1), (5, 5), (20, 10))
    ),
    *(
        Row(
            name=f"{number} runs of {n}, {'one boot' if one_boot else 'a boot each'}, {name}",
            draw=partial(proven_in_pieces, number, n, rates, one_boot), at_most=20.0 if bad else 100.0,
            at_least=0.0 if bad else 88.0, quick=quick, long=200, reported=reported,
            remedy=_UNEXAMINED if bad and quick else None,
        )
        for number, n, name, rates, bad, quick, reported in (
            (50, 2000, "the last at 5 P, the others at P/10", _late(49, 5), True, 20, "96"),
            (50, 2000, "the last five at 2 P, the others at P/10", _late(45, 2), True, 0, "62"),
            (100, 10_000, "the last ten at 3 P, the others at P/10", _late(90, 3), True, 0, "100"),
            (50, 2000, "the first three at 4 P, the others at P/10", lambda k: P * (4 if k < 3 else 0.1), True, 0, ""),
            (50, 2000, "all at P/10", lambda _: P / 10, False, 20, ""),
        )
        for one_boot in (True, False)
    ),
    *(
        Row(
            name=f"a load comes {turns} times{'' if regular else ' at random'}, 20 runs, P(miss) = {rate / P:g} P",
            draw=partial(proven_in_rounds, turns, rate, regular), at_most=5.0 if rate == P else 100.0,
            at_least=80.0 if rate < P and turns >= 8 else 0.0, quick=quick, long=100,
            remedy=(deadline, "examine_constancy", _run_by_run) if quick else None,
            reported="0 to 6" if rate < P else "",
        )
        for turns, rate, regular, quick in (
            (3, P / 10, True, 0),
            (8, P / 10, True, 10),
            (12, P / 10, True, 0),
            (30, P / 10, False, 0),
            (8, P, True, 0),
            (8, P, False, 0),
            (30, P, False, 0),
        )
    ),
    *(
        Row(
            name=f"values {times:g} times as high at the start, misses 30 times as frequent, by 1/e less each {memory} "
            f"loops; P(miss) = P/10 then, {number} run{'s' * (number > 1)} of 10 000",
            event="PROVEN, and the start-up reported",
            draw=partial(
                proven_after_startup,
                number,
                partial(processes.starting_up, 10_000, P / 10, memory=memory, times=times),
            ),
            # Eight thousand loops prove it in 75 % of cases where there is no start-up at all.
            at_least=60.0 if number == 1 else 80.0, quick=20 if memory == 500 else 0, long=200,
            remedy=(startup, "find_startup", lambda *_: None) if memory == 500 else None,
        )
        for number in (1, 5, 20)
        for memory in (125, 500)
        for times in (2.0, 3.0)
    ),
    *(
        Row(
            name=f"no start-up: {name}, {number} run{'s' * (number > 1)} of 10 000", event="a start-up is left out",
            draw=partial(startup_found, number, partial(process, 10_000, P)), at_most=1.0,
            quick=100 if quick and number == 1 else 0, long=1000 if number < 20 else 200,
            remedy=(startup, "SIGNIFICANT", 1.0) if quick and number == 1 else None,
        )
        for number in (1, 5, 20)
        for name, process, quick in (
            ("independent", processes.independent, True),
            ("AR(0.5)", partial(processes.autoregressive, memory=0.5), False),
            ("AR(0.9)", partial(processes.autoregressive, memory=0.9), False),
            ("AR(0.99)", partial(processes.autoregressive, memory=0.99), True),
            ("bursts of 5", partial(processes.bursts, length=5.0), False),
            ("bursts of 20", partial(processes.bursts, length=20.0), True),
            ("heavy tail", processes.heavy_tailed, False),
            ("a load of 1000 loops at random", partial(processes.slow_load, turn=1000, regular=False), False),
            ("a load of 3000 loops at random", partial(processes.slow_load, turn=3000, regular=False), False),
        )
    ),
    *(
        Row(
            name=f"values twice as high at the start, fading by 1/e in 125 loops, {name}, {number} "
            f"run{'s' * (number > 1)} of {n}",
            event=f"PROVEN and said to hold for bursts of {length}" if length > 1 else "PROVEN",
            draw=partial(
                proven_after_startup,
                number,
                partial(processes.starting_up, n, P, process=process, memory=125, times=2.0, misses=misses),
                length=length,
            ),
            at_most=5.0, quick=60 if length == 5 and number == 5 else 0, long=500 if number < 20 else 200,
        )
        for name, length, process in (
            ("independent", 1, processes.independent),
            ("AR(0.9)", 1, partial(processes.autoregressive, memory=0.9)),
            ("bursts of 5", 5, partial(processes.bursts, length=5.0)),
            ("bursts of 20", 20, partial(processes.bursts, length=20.0)),
        )
        for number, n, misses in ((1, 50_000, 1.0), (5, 20_000, 30.0), (20, 10_000, 30.0))
    ),
    Row(
        name="the slowest load that the plan says these runs can judge, 10 runs of 24 000", event="a change is seen",
        draw=partial(changes_under_the_slowest_load, 240_000), at_most=15.0, quick=20, long=500,
        remedy=(constancy, "slowest_load", lambda length: length / 3),
    ),
    *(
        Row(
            name=f"bursts of {length}, a goal that asks for them, a look after each of 40 rounds of {250 * length}",
            event="PROVEN at any look", draw=partial(proven_at_any_look_in_bursts, length), at_most=5.0,
            quick=10 if length == 20 else 0, long=100, reported={5: "47", 20: "83"}[length],
            remedy=(deadline, "longest_burst", _any_burst),
        )
        for length in (5, 20)
    ),
    *(
        Row(
            name=f"stalls of 10 ms at 1 kHz, the bursts of the default, n = {n:.0e}",
            draw=partial(proven_at_1_khz, partial(processes.clumps, n, P / 10, size=10)), at_most=5.0,
            quick=60 if n < 40_000 else 0, reported=reported,
            remedy=(deadline, "bursts_asked", _singly) if n < 40_000 else None,
        )
        for n, reported in ((4000, "69"), (10_000, "45"), (40_000, ""))
    ),
    Row(
        name="independent at 1 kHz, the bursts of the default, P(miss) a tenth of the target, n = 1e5",
        draw=partial(proven_at_1_khz, partial(processes.independent, 100_000, P / 10)), at_least=80.0, quick=20,
    ),
    *(
        Row(
            name=f"episodes of misses, one in {1 / rate:.0f} loops, length {name}, {looks} look"
            f"{'s, each after 10 000 more' * (looks > 1)}",
            event="more come in an hour than the answer states at most", at_most=5.0, quick=quick,
            draw=partial(come_more_often_than_stated, lengths, rate, 10_000, looks),
            remedy=(deadline, "anytime_upper", _one_look) if quick and looks > 1 else None,
        )
        for name, lengths in processes.LENGTHS.items()
        for rate, looks, quick in ((1 / 5000, 1, 0), (1 / 500, 1, 40), (1 / 5000, 10, 40 if "heavy" in name else 0))
    ),
    Row(
        name="episodes of misses, 5 boots, rates lognormal (sd 1)", at_most=5.0, quick=40,
        event="more come in an hour than the answer states at most",
        draw=partial(come_more_often_than_stated_of_boots, 5, 1.0),
        remedy=(deadline, "_effect_between", _never_between),
    ),
    *(
        Row(
            name=f"a look after each of 30 boots from the fifth on, rates lognormal (sd {spread:g})",
            event="PROVEN at any look", draw=partial(proven_at_any_look_in_boots, spread), quick=0, long=100,
        )
        for spread in (0.5, 1.0)
    ),
    *(
        Row(
            name=f"a cyclic timer, ten calls late in a row, P(lateness > deadline) = P, judged by {of}",
            draw=partial(proven_of_a_timer, of), at_most=at_most, at_least=at_least, quick=20, long=500,
        )
        for of, at_most, at_least in (("lateness", 8.0, 0.0), ("jitter", 100.0, 80.0))
    ),
    *(
        Row(
            name=f"at most {tolerance}: P(more) = P, {name}, n = {n:.0e}",
            draw=partial(proven_with_some_tolerated, make, tolerance), at_most=5.0 if n < 30_000 else 7.0, quick=quick,
            long=500,
            remedy=(deadline, "_least_effect", lambda *_: 1.0) if n < 30_000 and tolerance == THREE_OF_100 else None,
        )
        for tolerance, name, n, make, quick in (
            (TWO_IN_A_ROW, "independent", 20_000, partial(processes.independent, 20_000, P ** (1 / 3)), 60),
            (TWO_IN_A_ROW, "3 at a time", 20_000, partial(processes.clumps, 20_000, P, size=3), 60),
            (
                *(THREE_OF_100, "4 at a time by a coarse clock", 20_000),
                *(partial(processes.clumps, 20_000, P / 97, size=4, coarse=True), 40),
            ),
            (
                *(THREE_OF_100, "4 at a time by a coarse clock", 380_000),
                *(partial(processes.clumps, 380_000, P / 97, size=4, coarse=True), 0),
            ),
            (THREE_OF_100, "4 at a time", 380_000, partial(processes.clumps, 380_000, P / 97, size=4), 0),
            (THREE_OF_100, "independent", 380_000, partial(processes.independent, 380_000, 0.0086), 0),
        )
    ),
    Row(
        name="a goal that is changed after looking, to any deadline and P(miss) that is allowed",
        event="PROVEN at any look", draw=proven_after_a_change_of_goal, at_most=5.0, quick=200,
        remedy=(questions, "may_follow", lambda *_: True),
    ),
    *(
        Row(
            name=f"what a layer adds, a steady drift, 8 runs of each layer in {name}", event="outside the interval",
            draw=partial(outside_the_interval, order), at_most=at_most, quick=200, reported=reported,
            remedy=(layers, "shift_without_drift", _in_pairs) if reported else None,
        )
        for name, order, at_most, reported in (
            ("turns (L U L U)", 8 * "LU", 8.0, "95"),
            ("balanced order (L U U L)", 4 * "LUUL", 8.0, ""),
            ("random order", "", 8.0, "44"),
        )
    ),
    Row(
        name="two sets that differ in nothing, a steady drift, 20 runs each, most of one before the other",
        event="DIFFERENT", draw=seen_to_differ, at_most=5.0, quick=20, long=200,
        remedy=(comparison, "is_interleaved", lambda *_: True),
    ),
    *(
        Row(
            name=f"compare: two runs of AR(0.95), {shift_ns / 1000:g} us apart", event="are seen to differ", quick=0,
            draw=partial(run_seen_to_differ, shift_ns), at_most=100.0 if shift_ns else 12.0,
            at_least=95.0 if shift_ns else 0.0, long=300,
        )
        for shift_ns in (0, 3000)
    ),
    Row(
        name="compare: two runs of AR(0.95), 3 us apart, the mean", event="outside the interval", quick=0,
        draw=shift_outside_its_interval, at_most=12.0, long=300,
    ),
    *(
        Row(
            name=f"compare: two runs of independent values, 0.7 us apart, {figure}", event="outside the interval",
            draw=partial(quantile_outside_its_interval, figure), at_most=12.0, quick=0, long=200,
        )
        for figure in ("p50", "p90", "p99")
    ),
    Row(
        name="compare: six boots a side in turn, which differ by 1.5 us", event="DIFFERENT", quick=0,
        draw=boots_seen_to_differ, at_most=8.0, long=300,
    ),
    *(
        Row(
            name=f"ten boots, each slower than the last by {part} of the smallest climb that is stated", quick=0,
            event="a change is seen", draw=partial(climb_is_seen, part), at_least=75.0 if part == 1 else 0.0,
            at_most=100.0 if part == 1 else 50.0, long=200,
        )
        for part in (1, 0.3)
    ),
    *(
        Row(
            name=f"{number} events that lie evenly", event="a change is seen", draw=partial(even_events_change, number),
            at_most=2.5, quick=0, long=1000,
        )
        for number in (2, 5, 30, 300)
    ),
    Row(
        # Either end is wrong in at most one case of twenty.
        name="looking after every measurement until 300 missed", event="outside the interval at any look", at_most=10.0,
        draw=outside_at_any_look, quick=0, long=200,
    ),
    *(
        Row(
            name=f"worst case of an exponential tail by {opinion}, steps of {step_ns} ns", event="outside the interval",
            draw=lambda rng, place=place, step_ns=step_ns: worst_cases(step_ns, rng)[place], at_most=15.0, quick=0,
        )
        for step_ns in (1, 1000)
        for place, opinion in enumerate(("peaks", "maxima", "the exponential tail"))
    ),
    *(
        Row(
            name=f"a GPD fitted to one of shape {shape:g}, steps of {step_ns} ns", event=f"rejected at {level:g}",
            draw=partial(fit_is_rejected, level, shape, step_ns), at_most=65.0 if level == 0.5 else 8.0,
            at_least=35.0 if level == 0.5 else 0.0, quick=0,
        )
        for shape in (-0.3, 0.0, 0.3)
        for step_ns in (1, 1000)
        for level in (0.05, 0.5)
    ),
    Row(
        name="a publisher that misses its rate in half of all runs, and then deadlines more often; repeated until kept",
        draw=proven_by_lucky_runs, at_most=0.0, quick=6, long=100, remedy=(studies, "lost_attempts", lambda *_: ()),
    ),
    *(
        Row(
            name=f"boots of {name} loops, lognormal, sd {sd:g}", event=answer,
            draw=partial(wrong_of_unlike_boots, answer, lengths, sd), at_most=5.0, long=500,
            quick=20 if sd == 1 and answer is Answer.PROVEN and lengths[0] == 10_000 else 0, reported=reported,
            remedy=(deadline, "count_alike", as_measured) if lengths[0] == 10_000 else None,
        )
        for name, lengths, of_answers in (
            ("four of 1e4 and one of 1e6", [*[10_000] * 4, 1_000_000], ("33", "20")),
            ("ten of 200 and one of 2e5", [*[200] * 10, 200_000], ("48", "")),
            ("ten of 1e3 to 1e6", [round(1000 * 10 ** (k / 3)) for k in range(10)], ("", "")),
        )
        for sd in (0.5, 1.0)
        for answer, reported in zip((Answer.PROVEN, Answer.REFUTED), of_answers if sd == 1 else ("", ""), strict=True)
    ),
    Row(
        name="a run in ten hangs, and is measured again until it does not; P = 0.1, 40 runs",
        draw=proven_by_those_that_did_not_hang, at_most=5.0, quick=20, long=400, reported="97",
        remedy=(deadline, "_late_share", _never_between),
    ),
    Row(name="a histogram without order, bursts of 5", draw=proven_without_order, at_most=0.0, quick=20, long=500),
    *(
        Row(
            name=f'"N more" in nine cases of ten, {name}, P(miss) = {rate / P:g} of the target, goes on {how}',
            event="enough", draw=partial(enough, processes.DEPENDENT[name], rate, as_seen),
            at_least=90.0 if as_seen else 0.0, quick=0, long=1000,
            reported="11" if name == "AR(0.9)" and not as_seen else "",
        )
        for name, rate in (("independent", P / 2), ("AR(0.5)", P / 2), ("AR(0.9)", P / 5))
        for as_seen, how in ((True, "as seen"), (False, "at its true rate"))
    ),
    *(
        Row(
            name=f"AR({memory:g}) at {rate} P, twice the measurements that as many independent ones need", event=answer,
            draw=partial(decided, memory, answer, 1), at_least=90.0, quick=40 if memory == 0.5 else 0,
            long=400 if memory < 0.9 else 100,
        )
        for memory in (0.5, 0.9, 0.99)
        for answer, rate in ((Answer.PROVEN, "0.1"), (Answer.REFUTED, "10"))
    ),
    *(
        Row(
            name=f"AR({memory:g}) at 0.1 P on five boots, twice the measurements that as many independent ones need",
            draw=partial(decided, memory, Answer.PROVEN, 5), at_least=90.0, quick=0, long=400 if memory < 0.99 else 100,
        )
        for memory in (0.5, 0.9, 0.99)
    ),
    Row(
        name="independent, P(miss) a tenth of the target, n = 1e4",
        draw=partial(proven, partial(processes.independent, 10_000, P / 10)), at_least=80.0, quick=60,
    ),
    *(
        Row(
            name=f"{number} boots of 4000, one in 20 has nearly all misses", event=event,
            draw=partial(proven_of_some_bad_boots, number, scope), at_most=100.0 if scope == 1 else 5.0,
            reported={5: "79", 20: "36"}.get(number, "") if scope == 1 else "",
            quick=20 if scope < 1 and number == 20 else 0,
            remedy=(Verdict, "unlike_boots", Unlike(unit="boot", measured=20, share=0.01))
            if scope < 1 and number == 20 else None, long=300,
        )
        for number in (5, 20, 72)
        for scope, event in ((1.0, "PROVEN"), (0.05, "PROVEN and said to hold for 95 % of boots"))
    ),
    *(
        Row(
            name=f"{number} boots, {percent(share, 1):.0f} % are bad and a {part} as long", draw=partial(
                proven_of_short_bad_boots, number, share, longer
            ),
            event="PROVEN and said to hold for boots like these", at_most=5.0,
            quick=40 if number == 10 and longer == 10 else 0, long=300,
            remedy=(deadline, "shorter", lambda *_: 0) if number == 10 and longer == 10 else None,
        )
        for number, share in ((5, 0.6), (10, 0.35), (20, 0.3))
        for longer, part in ((10, "tenth"), (100, "hundredth"))
    ),
    *(
        Row(
            name=f"fractional noise (H = 0.9), {number} run{'s, a boot each' * (number > 1)}, n = 1e5 in all",
            draw=partial(proven_of_fractional_noise, number), at_most=100.0 if number == 1 else 5.0,
            reported={1: "25", 5: "1.5"}[number], quick=0, long=300,
        )
        for number in (1, 5)
    ),
    Row(
        name="compare: twelve groups that differ in nothing, five runs a side in turn",
        event="any is called DIFFERENT", draw=some_group_differs, at_most=8.0, quick=0, long=150,
    ),
    Row(
        # Seven claims can be decided wrongly, each at the level of 5 %.
        name="ten groups that differ in nothing, five runs each (claims)",
        event="a claim of the thesis is decided wrongly", draw=lambda rng: bool(null_campaigns.decided(rng)),
        at_most=30.0, quick=0, long=100, reported="70 to 90",
    ),
    *(
        Row(
            name=f"why: late values every {period} ms, 1 kHz for {n // 1000} s", event="the period is found",
            draw=partial(late_values.is_found, n, period), at_least=90.0,
            quick=10 if n == 60_000 and period in (20, 100, 3000, 7500) else 0, long=100 if n == 60_000 else 40,
            reported={(60_000, 1000): "100"}.get((n, period), "0" if period in reported else ""),
            remedy=(recurrence, "counts_tried", lambda values: iter([values // 1000])) if period == 100 else None,
        )
        for n, periods, reported in (
            (60_000, (20, 50, 100, 200, 333, 1000, 3000, 5000, 7500), (100, 200, 333, 3000)),
            (600_000, (20, 100, 500, 10_000, 75_000), (100, 500, 10_000)),
        )
        for period in periods
    ),
    *(
        Row(
            name=f"why: no period, {name}, 1 kHz for 60 s", event="a period is found",
            draw=partial(late_values.finds_one, 60_000, make), at_most=0.2, quick=20 if name == "bursts of 100" else 0,
            long=500, remedy=(recurrence, "_phases", _each_event) if name == "bursts of 100" else None,
        )
        for name, make in late_values.WITHOUT_PERIOD.items()
    ),
]  # fmt: skip
