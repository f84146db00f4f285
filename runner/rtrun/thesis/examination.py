"""The tools of the examiners of claims: results, the choice of groups and pairs, and their comparison."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rtfiles.quantities import signed, time
from rtrun.analysis.comparison.differences import Comparison, ComparisonAnswer, Shift, compare
from rtrun.analysis.comparison.effects import Effect, examine_effect, holm
from rtrun.analysis.comparison.layers import figure_of
from rtrun.analysis.dependence.blocks import Blocks
from rtrun.analysis.dependence.interleaving import is_interleaved
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.kinds.kind import MeasurementKind
from rtrun.plan.short_names import format_parameters
from rtrun.plan.suites import is_real_time, kind_of

# Fewer runs a side do not show how much runs differ without a cause.
LEAST_RUNS = 5
# "Never" is confirmed when P is below it: 3689 measurements without one at 95 %.
NEVER_BELOW = 1e-3
# The least effect that confirms a claim that names none.
_LEAST_PART = 0.05


class Finding(StrEnum):
    """What the data say about a claim."""

    CONFIRMED = "confirmed"
    REFUTED = "refuted"
    UNDECIDED = "undecided"


@dataclass(frozen=True, kw_only=True)
class ClaimResult:
    """What an examiner found: the answer, the numbers it rests on, the test, and the runs."""

    finding: Finding
    numbers: str
    test: str = "none"
    runs: tuple[str, ...] = ()


def no_runs(what: str) -> ClaimResult:
    """No run of the campaign bears on the claim."""
    return ClaimResult(finding=Finding.UNDECIDED, numbers=f"no {what} in this campaign")


def select(groups: Iterable[Group], kind: MeasurementKind | str, *, rt: bool | None = None) -> list[Group]:
    """The groups of a kind, or of a baseline, that measured something; `rt`: with a real-time policy, or without."""
    measured = [group for group in groups if is_of(group.suite, kind) and group.n]
    return [group for group in measured if rt is None or is_real_time(group.parameters) is rt]


def is_of(suite: str, kind: MeasurementKind | str) -> bool:
    """Whether a suite is of a kind, or is the baseline of this name."""
    return suite == kind if isinstance(kind, str) else kind_of(suite) is kind


def runs_of(groups: Iterable[Group]) -> tuple[str, ...]:
    """The names of the groups' runs, each once."""
    return tuple(dict.fromkeys(run for group in groups for run in group.runs))


def pairs(groups: list[Group], key: str, a: object, b: object) -> Iterator[tuple[Group, Group]]:
    """Pairs of groups that differ only in one parameter, which is `a` in the first and `b` in the second."""
    for first in groups:
        for second in groups:
            if (first.parameters.get(key), second.parameters.get(key)) == (a, b) and _rest(first, key) == _rest(
                second, key
            ):
                yield first, second


def _rest(group: Group, key: str) -> tuple[object, ...]:
    return group.target, group.suite, tuple(sorted((k, str(v)) for k, v in group.parameters.items() if k != key))


def compared(pair: tuple[Group, Group], confidence: float) -> Comparison | None:
    """The comparison of a pair; None where one of them has too few values."""
    first, second = pair
    blocks: tuple[tuple[Blocks, ...], tuple[Blocks, ...]] = (first.blocks, second.blocks)
    if not all(blocks):
        return None
    step_ns = max(first.clock_step_ns, second.clock_step_ns)
    comparison = compare(*blocks, confidence=confidence, clock_step_ns=step_ns)
    return None if comparison.answer == ComparisonAnswer.UNDECIDED else comparison


def describe_shift(shift: Shift, confidence: float) -> str:
    """A shift in words: from, to, and the interval."""
    return (
        f"{shift.figure} {time(shift.a_ns)} -> {time(shift.b_ns)} "
        f"({100 * confidence:g} % CI of the shift {signed(shift.low_ns)} to {signed(shift.high_ns)})"
    )


def examine_shift(
    study: Study,
    candidates: Iterable[tuple[Group, Group]],
    figure: str,
    sign: int,
    missing: str,
    *,
    least_ns: float = 0.0,
    least_part: float = 0.0,
) -> ClaimResult:
    """Decide a claim that a figure ("mean" or "p99") moves in the direction of `sign` in every pair of groups.

    The claimed effect, `least_ns` or a part of the first group's figure, is the least that confirms; a smaller one
    refutes. A claim that names no effect is confirmed by 5 % and refuted by a shift in the other direction. Runs are
    the units: a pair counts with five runs a side that were measured in turn. Confirmed when every pair shows it (each
    at the level of the study, no correction needed); refuted when one pair shows the contrary, after Holm over all
    pairs.
    """
    effects: list[tuple[tuple[Group, Group], Effect]] = []
    left_out: list[Group] = []
    for pair in candidates:
        runs = [group.blocks for group in pair]
        starts = [[run.start_time for run in side] for side in runs]
        if min(map(len, runs)) < LEAST_RUNS or not is_interleaved(*starts):
            left_out += pair
            continue
        a, b = (np.array([figure_of(run, figure) for run in side]) for side in runs)
        claimed = max(least_ns, least_part * float(a.mean()))
        least = claimed or _LEAST_PART * float(abs(a.mean()))
        effects.append((pair, examine_effect(a, b, sign=sign, least_ns=least, refuting_ns=claimed)))
    test = f"Welch's t over runs, {LEAST_RUNS} a side at least and measured in turn; refuted after Holm over all pairs"
    if not effects:
        if not left_out:
            return no_runs(missing)
        return ClaimResult(
            finding=Finding.UNDECIDED,
            numbers=f"no pair has {LEAST_RUNS} runs a side that were measured in turn",
            test=test,
            runs=runs_of(left_out),
        )
    level = 1 - study.question.confidence
    if any(holm([effect.p_below for _, effect in effects], level)):
        finding = Finding.REFUTED
    else:
        finding = Finding.CONFIRMED if all(e.p_above <= level for _, e in effects) else Finding.UNDECIDED
    return ClaimResult(
        finding=finding,
        numbers="; ".join(
            f"{format_parameters(pair[0].parameters)}: {figure} {time(effect.a_ns)} -> {time(effect.b_ns)} "
            f"(as claimed: p = {effect.p_above:.1g}, not: p = {effect.p_below:.1g})"
            for pair, effect in effects
        ),
        test=test,
        runs=runs_of(group for pair, _ in effects for group in pair),
    )
