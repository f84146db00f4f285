"""Examiners of the claims on communication and on the system as a whole (thesis sections 4.3.2 and 4.4)."""

from dataclasses import replace

import numpy as np

from rtfiles.quantities import signed, time
from rtrun.analysis.chance.intervals import clopper_pearson
from rtrun.analysis.comparison.differences import ComparisonAnswer
from rtrun.analysis.comparison.effects import holm
from rtrun.analysis.order.periods import burst_peaks, evenly_spread_p, find_period
from rtrun.judgement.digest import JudgedDigest
from rtrun.judgement.groups import Group, slowest
from rtrun.judgement.study import Study
from rtrun.kinds import messages, oneshot
from rtrun.kinds.known import KINDS
from rtrun.plan.suites import kind_of
from rtrun.thesis.examination import (
    NEVER_BELOW,
    ClaimResult,
    Finding,
    compared,
    examine_shift,
    is_of,
    no_runs,
    pairs,
    runs_of,
    select,
)

ONESHOT, COMMUNICATION, CYCLICTEST = oneshot.KIND, messages.KIND, "cyclictest"
_BROADER_NS = 300_000  # of the claim: from about 200 to about 500 us


def peaks_random(study: Study) -> ClaimResult:
    """The highest values of each run lie anywhere: they are evenly spread, and at no fixed distance."""
    by_run: dict[str, JudgedDigest] = {}
    for d in slowest([d for group in study.as_in_2014 for d in group.digests]):
        if kind_of(d.header.suite) and d.n >= 1000 and any(entry.index is not None for entry in d.figures.top):
            by_run[d.run] = d
    if not by_run:
        return no_runs("run of 1000 measurements or more that lists where its peaks lie")
    peaks = []
    for d in by_run.values():
        listed = [entry.index for entry in d.figures.top if entry.index is not None]
        peaks.append((burst_peaks(listed, d.loops), d.loops))
    places = np.concatenate([(at + 0.5) / loops for at, loops in peaks])
    spread_p = evenly_spread_p(places)
    period, period_p = find_period(peaks)
    if min(spread_p, period_p) < 0.01 / 2:
        finding = Finding.REFUTED
    else:
        finding = Finding.CONFIRMED if places.size >= 100 else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers=f"places of {places.size} peaks in {len(by_run)} runs, p = {spread_p:.2g} for an even spread, "
        f"p = {period_p:.2g} for no period (strongest: {period} loops)",
        test="Kolmogorov-Smirnov against the uniform distribution and Rayleigh's test for periods, one peak a burst: "
        "refuted below 0.005, confirmed with 100 peaks",
        runs=tuple(by_run),
    )


def nanosleep_better(study: Study) -> ClaimResult:
    """The highest value of cyclictest is lower than that of the one-shot timer."""
    timers, base = select(study.as_in_2014, ONESHOT, rt=True), select(study.as_in_2014, CYCLICTEST)
    if not timers or not base:
        return no_runs(
            "cyclictest run"
            if timers
            else "one-shot run with real-time priority"
            if base
            else "cyclictest or one-shot run"
        )
    # The deadline each would have met: its highest value; the same number of measurements on both sides counts.
    below = [d.figures.max_ns for g in base for d in g.digests]
    above = max(d.figures.max_ns or 0 for g in timers for d in g.digests)
    runs = runs_of([*timers, *base])
    if any(value is None for value in below):
        return ClaimResult(
            finding=Finding.UNDECIDED, numbers="a cyclictest histogram overflowed, its maximum is not in it", runs=runs
        )
    worst = max(value for value in below if value is not None)
    n_base, n_timer = sum(g.n for g in base), sum(g.n for g in timers)
    if worst >= above and n_base <= n_timer:
        finding = Finding.REFUTED
    else:
        finding = Finding.CONFIRMED if 2 * worst <= above and n_base >= n_timer else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers=f"highest value: cyclictest {time(worst)} of {n_base}, ROS one-shot timer {time(above)} of {n_timer}",
        test="maxima; confirmed at half or less of as many values, refuted when not lower of as few",
        runs=runs,
    )


def comm_first_message_worst(study: Study) -> ClaimResult:
    """The first message is the slowest."""
    digests = [
        d
        for g in select(study.as_in_2014, COMMUNICATION)
        for d in g.digests
        if d.header.startup and d.figures.max_ns is not None
    ]
    if not digests:
        return no_runs("communication run whose first message came")
    worst = [d for d in digests if d.figures.max_ns is not None and d.header.startup[0].value_ns > d.figures.max_ns]
    low, high = clopper_pearson(len(worst), len(digests), study.question.confidence)
    finding = Finding.CONFIRMED if low > 0.5 else Finding.REFUTED if high < 0.5 else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers=f"the first message was the slowest for {len(worst)} of {len(digests)} subscribers "
        f"({100 * study.question.confidence:g} % CI of the share {low:.2f} to {high:.2f})",
        test="Clopper-Pearson against one half",
        runs=tuple(dict.fromkeys(d.run for d in digests)),
    )


def comm_more_subscribers_broader(study: Study) -> ClaimResult:
    """Five subscribers receive later, over a range that is broader by 300 us, than one."""
    candidates = list(pairs(select(study.as_in_2014, COMMUNICATION, rt=True), "subscribers", 1, 5))
    missing = "pair of communication runs with one and five real-time subscribers"
    result = examine_shift(study, candidates, "p99", +1, missing)
    ranges = [[_range_ns(group) for group in pair] for pair in candidates]
    broader = all(five - single >= _BROADER_NS for single, five in ranges)
    if result.finding == Finding.CONFIRMED and not broader:
        result = replace(result, finding=Finding.UNDECIDED)
    words = [f"range {time(single)} -> {time(five)}" for single, five in ranges]
    return replace(result, numbers="; ".join([result.numbers, *words]))


def _range_ns(group: Group) -> int:
    highest = max((d.figures.max_ns or 0 for d in group.digests), default=0)
    return highest - min((d.figures.min_ns or 0 for d in group.digests), default=0)


def comm_higher_frequency_faster(study: Study) -> ClaimResult:
    """The mean latency is lower at 1 kHz than at 100 Hz."""
    groups = select(study.as_in_2014, COMMUNICATION, rt=True)
    return examine_shift(
        study, pairs(groups, "frequency_hz", 100, 1000), "mean", -1, "pair of communication runs at 100 Hz and 1 kHz"
    )


def comm_nothing_lost(study: Study) -> ClaimResult:
    """No message is missing or out of order."""
    digests = [d for g in study.groups if is_of(g.suite, COMMUNICATION) for d in g.digests]
    if not digests:
        return no_runs("communication run")
    missing, swapped = sum(d.header.missing for d in digests), sum(d.header.out_of_order for d in digests)
    n = sum(d.loops for d in digests)
    enough = clopper_pearson(0, n, study.question.confidence)[1] < NEVER_BELOW
    return ClaimResult(
        finding=Finding.REFUTED if missing or swapped else Finding.CONFIRMED if enough else Finding.UNDECIDED,
        numbers=f"{missing} missing and {swapped} out of order of {n} messages expected",
        test=f"counts; confirmed when none and P below {NEVER_BELOW:g} (Clopper-Pearson)",
        runs=tuple(dict.fromkeys(d.run for d in digests)),
    )


def rr_equals_fifo(study: Study) -> ClaimResult:
    """RR and FIFO give the same distribution."""
    compared_pairs = []
    for kind in KINDS.values():
        for pair in pairs(select(study.as_in_2014, kind, rt=True), "policy", "RR", "FIFO"):
            comparison = compared(pair, study.question.confidence)
            if comparison is not None:
                compared_pairs.append((pair, comparison))
    if not compared_pairs:
        return no_runs("pair of runs with RR and FIFO")
    alike = [all(s.within_margin for s in c.shifts) for _, c in compared_pairs]
    significant = holm([c.p_value for _, c in compared_pairs], 1 - study.question.confidence)
    differing = [
        c.answer == ComparisonAnswer.DIFFERENT and beyond_chance and not within
        for (_, c), beyond_chance, within in zip(compared_pairs, significant, alike, strict=True)
    ]
    finding = Finding.REFUTED if any(differing) else Finding.CONFIRMED if all(alike) else Finding.UNDECIDED
    if any(differing) and any(c.units == "blocks" for _, c in compared_pairs):
        # One boot or run may differ from the next whatever the policy: too few runs to blame the policy.
        finding = Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers="; ".join(
            f"{pair[0].label}: {c.answer} (mean {signed(c.shifts[0].shift_ns)}, p = {c.p_value:.2g})"
            for pair, c in compared_pairs
        ),
        test="permutation of blocks or runs, and equivalence within 5 %; refuted with five runs a side only, "
        "after Holm over all pairs",
        runs=runs_of(group for pair, _ in compared_pairs for group in pair),
    )


def single_cpu_shutdown_stuck(study: Study) -> ClaimResult:
    """A single CPU hangs at shutdown: the runner prevents it, so no run decides the claim."""
    single = [record.run for record in study.records if record.target.cpus == 1]
    if not single:
        return no_runs("run on a target with one CPU")
    return ClaimResult(
        finding=Finding.UNDECIDED,
        numbers=f"{len(single)} runs on one CPU, but the runner keeps the master above the nodes' priority, as it must",
        runs=tuple(single),
    )


def default_priority_unpredictable(study: Study) -> ClaimResult:
    """The 99th percentile is higher without real-time priority."""
    candidates = [
        pair
        for kind in KINDS.values()
        for policy in ("RR", "FIFO")
        for pair in pairs(select(study.as_in_2014, kind), "policy", policy, "0")
    ]
    # "Drastically" is read as twice as much: the shift is as large as the figure.
    return examine_shift(
        study, candidates, "p99", +1, "pair of runs with and without real-time priority", least_part=1.0
    )
