"""Examiners of the claims on the one-shot and the cyclic timer (thesis sections 4.1.2 and 4.2.2)."""

from dataclasses import replace

import numpy as np

from rtfiles.quantities import time
from rtrun.analysis.account import Account
from rtrun.analysis.chance.intervals import clopper_pearson
from rtrun.analysis.deadline import judge
from rtrun.judgement.digest import Digest
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.kinds import cyclic, oneshot
from rtrun.plan.question import NONE_TOLERATED, THESIS
from rtrun.plan.short_names import format_parameters
from rtrun.plan.suites import is_real_time
from rtrun.thesis.examination import (
    NEVER_BELOW,
    ClaimResult,
    Finding,
    compared,
    describe_shift,
    examine_shift,
    is_of,
    no_runs,
    pairs,
    runs_of,
    select,
)

ONESHOT, CYCLIC = oneshot.KIND, cyclic.KIND
_MS = 1_000_000
_DEADLINE_NS = THESIS.limit_ns


def oneshot_sub_millisecond(study: Study) -> ClaimResult:
    """If every timer waits 1 ms whatever its timeout, no latency is below 1 ms - timeout, and the mean grows by that
    much."""
    groups = [group for group in select(study.as_in_2014, ONESHOT) if 0 < _number(group, "timeout_us") < 1000]
    if not groups:
        return no_runs("one-shot run with a timeout below 1 ms")
    shares, grown, words = [], [], []
    for group in groups:
        least = _MS - 1000 * _number(group, "timeout_us")
        sooner = sum(int(d.histogram.counts[d.histogram.values_ns < least - 1000].sum()) for d in group.digests)
        low, high = clopper_pearson(sooner, group.n, study.question.confidence)
        shares.append((low, high))
        words.append(f"{format_parameters(group.parameters)}: {sooner} of {group.n} latencies below {least // 1000} us")
        for pair in pairs(select(study.as_in_2014, ONESHOT), "timeout_us", 1000, group.parameters["timeout_us"]):
            comparison = compared(pair, study.question.confidence)
            if comparison is not None and pair[1].key == group.key:
                shift = comparison.shifts[0]
                grown.append(0.5 * least < shift.low_ns and shift.high_ns < 1.5 * least)
                words.append(f"beside 1 ms {describe_shift(shift, study.question.confidence)}")
    if all(high < 0.05 for _, high in shares) and grown and all(grown):
        finding = Finding.CONFIRMED
    elif all(low > 0.5 for low, _ in shares):
        finding = Finding.REFUTED
    else:
        finding = Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers="; ".join(words),
        test="share of latencies below (1 ms - timeout), Clopper-Pearson: refuted above 50 %, confirmed below 5 % "
        "with the mean grown by (1 ms - timeout), half of it more or less",
        runs=runs_of(groups),
    )


def oneshot_ignored_without_rt(study: Study) -> ClaimResult:
    """Timers that do not fire: some without real-time priority, none with it."""
    groups = [g for g in study.groups if is_of(g.suite, ONESHOT)]
    with_rt, without = ([g for g in groups if is_real_time(g.parameters) is rt] for rt in (True, False))
    if not with_rt and not without:
        return no_runs("one-shot run")
    lost_rt, lost = (sum(d.header.not_fired for g in side for d in g.digests) for side in (with_rt, without))
    n_rt, n = (sum(d.n + d.header.not_fired for g in side for d in g.digests) for side in (with_rt, without))
    upper = clopper_pearson(lost, n, study.question.confidence)[1]
    if lost_rt:
        finding = Finding.REFUTED
    elif lost and clopper_pearson(0, n_rt, study.question.confidence)[1] < NEVER_BELOW:
        finding = Finding.CONFIRMED
    else:
        # "Now and then" is read as once in a million, no less.
        finding = Finding.REFUTED if n and upper < 1e-6 else Finding.UNDECIDED
    of_loops = f"{lost} of {n} without real-time priority (P below {upper:.1e})" if n else "no run without priority"
    return ClaimResult(
        finding=finding,
        numbers=f"not fired: {of_loops}, " + (f"{lost_rt} of {n_rt} with it" if n_rt else "no run with it"),
        test="counts, Clopper-Pearson",
        runs=runs_of([*with_rt, *without]),
    )


def oneshot_reported_accurate(study: Study) -> ClaimResult:
    """With real-time priority, what the timer reports is what was measured; without, milliseconds apart."""
    differences = [
        d for d in study.others if is_of(d.header.suite, ONESHOT) and d.header.series == "difference_2014" and d.n
    ]
    rt, without = ([d for d in differences if is_real_time(d.header.parameters) is rt] for rt in (True, False))
    if not rt:
        return no_runs("one-shot run with real-time priority and reported values")
    mean = max(float(np.average(np.abs(d.histogram.values_ns), weights=d.histogram.counts)) for d in rt)
    peak, peak_without = _highest_difference(rt), _highest_difference(without)
    if mean >= 10_000 or peak >= 80_000:
        finding = Finding.REFUTED
    elif peak_without >= _MS:
        finding = Finding.CONFIRMED
    else:
        finding = Finding.UNDECIDED
    words = f"peak {time(peak_without)}" if without else "no run"
    return ClaimResult(
        finding=finding,
        numbers=f"|reported - measured|: with priority mean {time(mean)}, peak {time(peak)} "
        "(claimed: below 10 and 80 us); "
        f"without: {words} (claimed: milliseconds)",
        test="largest mean and peak of all runs",
        runs=tuple(dict.fromkeys(d.run for d in differences)),
    )


def oneshot_400us_rare(study: Study) -> ClaimResult:
    """A latency above 400 us comes less than once in a million."""
    groups = select(study.as_in_2014, ONESHOT, rt=True)
    if not groups:
        return no_runs("one-shot run with real-time priority")
    late, low, high, n, method = _pooled(study, groups)
    finding = Finding.REFUTED if low > 1e-7 else Finding.CONFIRMED if high < 1e-6 else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers=f"{late} of {n} above 400 us, P between {low:.1e} and {high:.1e} "
        f"({100 * study.question.confidence:g} % CI)",
        test=f"{method}: refuted above 1e-7, confirmed below 1e-6",
        runs=runs_of(groups),
    )


def oneshot_latency_grows_with_timeout(study: Study) -> ClaimResult:
    """The mean latency is higher at 10 ms than at 1 ms, by 50 us."""
    groups = select(study.as_in_2014, ONESHOT, rt=True)
    return examine_shift(
        study,
        pairs(groups, "timeout_us", 1000, 10000),
        "mean",
        +1,
        "pair of one-shot runs with 1 ms and 10 ms",
        least_ns=50_000,
    )


def cyclic_negative_cluster(study: Study) -> ClaimResult:
    """About 12 % of the jitter values lie near -900 us."""
    groups = select(study.as_in_2014, CYCLIC)
    clusters = [d.cluster for g in groups for d in g.digests if d.cluster is not None]
    if not clusters:
        return no_runs("cyclic run")
    inside, n = sum(c.n for c in clusters), sum(g.n for g in groups)
    low, high = clopper_pearson(inside, n, study.question.confidence)
    places = [c.median_ns for c in clusters if c.median_ns is not None]
    near = all(-1_000_000 <= place <= -600_000 for place in places)
    if low > 0.05 and near:
        finding = Finding.CONFIRMED
    else:
        # Less than a tenth of the claimed share is another phenomenon than "about 12 %".
        finding = Finding.REFUTED if high < 0.012 or (low > 0.05 and not near) else Finding.UNDECIDED
    where = f", medians {time(min(places))} to {time(max(places))}" if places else ""
    return ClaimResult(
        finding=finding,
        numbers=f"{100 * inside / n:.2f} % of {n} jitter values below -500 us{where} (claimed: 12 % near -900 us)",
        test="share below -500 us, Clopper-Pearson: confirmed above 5 % and near, refuted below 1.2 % or elsewhere",
        runs=runs_of(groups),
    )


def cyclic_first_two_negative(study: Study) -> ClaimResult:
    """At 100 Hz one of the first two periods is shorter by more than 2 ms, and none later."""
    groups = [g for g in select(study.as_in_2014, CYCLIC) if _number(g, "frequency_hz") == 100]
    digests = [d for g in groups for d in g.digests if d.header.startup]
    if not digests:
        return no_runs("cyclic run at 100 Hz that lists its first two periods")
    hit = [d for d in digests if min(value.value_ns for value in d.header.startup) <= -2 * _MS]
    later = [d for d in digests if d.figures.min_ns is not None and d.figures.min_ns <= -2 * _MS]
    finding = Finding.REFUTED if later or not hit else Finding.CONFIRMED
    if not hit and not later and len(digests) < 3:
        finding = Finding.UNDECIDED
    lowest = min(value.value_ns for d in digests for value in d.header.startup)
    return ClaimResult(
        finding=finding,
        numbers=f"{len(hit)} of {len(digests)} runs have a jitter below -2 ms in the first two periods (lowest "
        f"{time(lowest)}), {len(later)} have one later",
        test="counts of runs; three without any refute it",
        runs=tuple(d.run for d in digests),
    )


def cyclic_frequency_kept(study: Study) -> ClaimResult:
    """The last call comes within one period of its due time: the jitter does not add up."""
    groups = [group for group in select(study.as_in_2014, CYCLIC) if _number(group, "frequency_hz")]
    drifts = []
    for group in groups:
        period = 1e9 / _number(group, "frequency_hz")
        for d in group.digests:
            if d.figures.mean_ns is not None:
                drift = d.figures.mean_ns * d.n + sum(value.value_ns for value in d.header.startup)
                drifts.append((d, drift, abs(drift) <= max(period, _MS), drift / (d.n + len(d.header.startup))))
    if not drifts:
        return no_runs("cyclic run whose frequency is known")
    kept = [fits for _, _, fits, _ in drifts]
    worst = max(drifts, key=lambda item: abs(item[1]))
    return ClaimResult(
        finding=Finding.CONFIRMED if all(kept) else Finding.REFUTED,
        numbers=f"in {sum(kept)} of {len(drifts)} runs the last call came within one period (at least 1 ms) of where "
        f"it belongs; worst: {time(worst[1])} off, mean jitter {time(worst[3])}",
        test="sum of all jitter values against one period",
        runs=tuple(d.run for d, *_ in drifts),
    )


def cyclic_400us_never(study: Study) -> ClaimResult:
    """No jitter value lies above 400 us."""
    groups = select(study.as_in_2014, CYCLIC, rt=True)
    if not groups:
        return no_runs("cyclic run with real-time priority")
    late, _, high, n, method = _pooled(study, groups)
    finding = Finding.REFUTED if late else Finding.CONFIRMED if high < 1e-6 else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers=f"{late} of {n} above 400 us, P below {high:.1e} ({100 * study.question.confidence:g} % CI)",
        test=f"{method}: confirmed when none and P below 1e-6",
        runs=runs_of(groups),
    )


def cyclic_degrades_above_1khz(study: Study) -> ClaimResult:
    """The 99th percentile of the jitter is higher above 1 kHz."""
    groups = select(study.as_in_2014, CYCLIC)
    faster = sorted({_number(g, "frequency_hz") for g in groups if _number(g, "frequency_hz") > 1000})
    candidates = [pair for hz in faster for pair in pairs(groups, "frequency_hz", 1000, hz)]
    return examine_shift(study, candidates, "p99", +1, "pair of cyclic runs at 1 kHz and above")


def _highest_difference(digests: list[Digest]) -> int:
    return max((int(np.abs(d.histogram.values_ns).max()) for d in digests), default=0)


def _number(group: Group, key: str) -> int:
    value = group.parameters.get(key)
    return value if isinstance(value, int) else 0


def _pooled(study: Study, groups: list[Group]) -> tuple[int, float, float, int, str]:
    """Values above 400 us, the interval of P, n, and the method, over all groups."""
    if study.question.deadline_ns == _DEADLINE_NS and study.question.tolerance == NONE_TOLERATED:
        runs = [run for group in groups if group.account for run in group.account.runs]
        if runs:
            verdict = judge(Account(runs), replace(THESIS, confidence=study.question.confidence))
            startups = [group.verdict.startup for group in groups if group.verdict and group.verdict.startup]
            late = sum(startup.late for startup in startups)
            apart = f"; start-ups left out, {late} late in them" if startups else ""
            return (
                verdict.late,
                verdict.lower,
                verdict.upper,
                verdict.n,
                f"interval on the effective sample size{apart}",
            )
    late = sum(d.histogram.above(_DEADLINE_NS) for g in groups for d in g.digests)
    n = sum(g.n for g in groups)
    method = "Clopper-Pearson, independence assumed, for the runs were held against another deadline"
    return (late, *clopper_pearson(late, n, study.question.confidence), n, method)
