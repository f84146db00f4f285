"""What an examiner of a claim works with: its result, the choice of groups and pairs, and their comparison."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from rtrun.analysis.blocks import Blocks
from rtrun.analysis.comparison import Change, Comparison, Shift, compare
from rtrun.report.study import Group, Study, told


class Finding(StrEnum):
    """What the data say about a claim."""

    CONFIRMED = "confirmed"
    REFUTED = "refuted"
    UNDECIDED = "undecided"


@dataclass(frozen=True, kw_only=True)
class Result:
    """What an examiner found: the answer, the numbers it rests on, the test, and the runs."""

    finding: Finding
    numbers: str
    test: str = "none"
    runs: tuple[str, ...] = ()


def no_runs(what: str) -> Result:
    """No run of the campaign bears on the claim."""
    return Result(finding=Finding.UNDECIDED, numbers=f"no {what} in this campaign")


def too_small(figure: str, groups: Iterable[Group]) -> Result:
    """Runs bear on the claim, but with too few measurements."""
    return Result(finding=Finding.UNDECIDED, numbers=f"too few measurements to compare {figure}", runs=runs_of(groups))


def select(study: Study, suite: str, *, rt: bool | None = None) -> list[Group]:
    """Groups of a suite that measured something; with real-time policy, without, or either."""
    return [group for group in study.groups if group.suite == suite and group.n and (rt is None or is_rt(group) is rt)]


def is_rt(group: Group) -> bool:
    """Whether the group's runs asked for a real-time policy."""
    return group.parameters.get("policy", "0") != "0"


def runs_of(groups: Iterable[Group]) -> tuple[str, ...]:
    """The names of the groups' runs, each once."""
    return tuple(dict.fromkeys(run for group in groups for run in group.runs))


def pairs(groups: list[Group], key: str, a: object, b: object) -> Iterator[tuple[Group, Group]]:
    """Groups that are alike but for one parameter, which is `a` in the first and `b` in the second."""
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
    return None if comparison.answer == Change.UNDECIDED else comparison


def shift_of(found: Comparison, figure: str) -> Shift | None:
    """The shift of one figure, None where the sets are too small for it."""
    return next((shift for shift in found.shifts if shift.figure == figure), None)


def describe_shift(shift: Shift, confidence: float) -> str:
    """A shift in words: from, to, and the interval."""
    return (
        f"{shift.figure} {us(shift.a_ns)} -> {us(shift.b_ns)} us "
        f"({100 * confidence:g} % CI of the shift {shift.low_ns / 1000:+.1f} to {shift.high_ns / 1000:+.1f} us)"
    )


def examine_shift(
    study: Study, candidates: Iterable[tuple[Group, Group]], figure: str, sign: int, missing: str
) -> Result:
    """Confirmed when every pair's figure moved in the direction of `sign`, refuted when one moved against it."""
    found, small = [], []
    for pair in candidates:
        comparison = compared(pair, study.confidence)
        shift = shift_of(comparison, figure) if comparison else None
        if shift is not None:
            found.append((pair, shift))
        else:
            small += [*pair]
    if not found:
        return too_small(figure, small) if small else no_runs(missing)
    with_it = [sign * (shift.low_ns if sign > 0 else shift.high_ns) > 0 for _, shift in found]
    against = [sign * (shift.high_ns if sign > 0 else shift.low_ns) < 0 for _, shift in found]
    finding = Finding.CONFIRMED if all(with_it) else Finding.REFUTED if any(against) else Finding.UNDECIDED
    return Result(
        finding=finding,
        numbers="; ".join(f"{told(pair[0].parameters)}: {describe_shift(s, study.confidence)}" for pair, s in found),
        test="block bootstrap interval of the shift",
        runs=runs_of(group for pair, _ in found for group in pair),
    )


def us(value_ns: float) -> str:
    """Nanoseconds as microseconds, a decimal where it tells something."""
    return f"{value_ns / 1000:.1f}" if abs(value_ns) < 1e6 else f"{value_ns / 1000:.0f}"
