"""Two folders of runs compared, group by group."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.analysis.comparison.differences import Comparison, Ratio, compare, correct, ratio_of_misses
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.groups import Group
from rtrun.judgement.sides import By, split
from rtrun.judgement.study import Study, study
from rtrun.kinds.known import MAIN_ONLY_IN_2014
from rtrun.plan.question import Question
from rtrun.targets.inspection.platform import Platform


@dataclass(frozen=True, kw_only=True)
class Changed:
    """One group on both sides, compared."""

    label: str
    comparison: Comparison
    p999_ns: tuple[int | None, int | None]
    max_ns: tuple[int | None, int | None]
    miss: str | None
    """What counts as a miss, in words; None where there is no deadline."""
    misses: Ratio | None
    runs: tuple[tuple[str, ...], tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Two compared sets: the groups in both, those in only one, and those with several possible matches."""

    platform: Platform
    deadline_ns: int | None
    miss: str
    """What counts as a miss, in words."""
    changes: tuple[Changed, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    ambiguous: tuple[str, ...]
    left_out: tuple[str, ...]


def compare_sets(a: Path, b: Path, question: Question, *, margin_ns: float | None) -> Compared:
    """Compare the results at two paths, group by group, as `compare_studies` does."""
    first, second = (study(path, question, bounds=False) for path in (a, b))
    return compare_studies(first, second, margin_ns=margin_ns)


def compare_sides(
    path: Path,
    by: By | None,
    names: Sequence[str],
    question: Question,
    *,
    margin_ns: float | None,
) -> tuple[tuple[str, str], Compared]:
    """Compare two variants of one campaign, or its kernels; return their names too. Raises UsageError like `split`."""
    whole = study(path, question, bounds=False)
    chosen, (first, second) = split(whole, by, names)
    return chosen, compare_studies(first, second, margin_ns=margin_ns)


def compare_studies(first: Study, second: Study, *, margin_ns: float | None) -> Compared:
    """Compare two studies of the same question, group by group.

    Groups of the same suite and parameters are compared if they are of the same target, or if each side has one such
    group: then the target is what changed. If one side has results of the programs of 2014, both sides are compared by
    measured_2014 of one-shot timers and by the jitter of cyclic ones, and the label says so. Groups that are not
    compared are in ``ambiguous``, ``only_a`` or ``only_b``. Raises UsageError for two platforms.
    """
    if first.platform is not second.platform and first.digests and second.digests:
        raise UsageError(
            f"{first.source.path} was measured on {first.platform.machine}, {second.source.path} on "
            f"{second.platform.machine}: times of different platforms are not compared"
        )
    as_in_2014 = {group.suite for side in (first, second) for group in side.groups if group.series in MAIN_ONLY_IN_2014}
    sides = [_by_circumstances(side, as_in_2014) for side in (first, second)]
    matches = [_match(*(side.get(key, []) for side in sides)) for key in dict.fromkeys((*sides[0], *sides[1]))]
    pairs = [pair for match in matches for pair in match.pairs]
    counts = Counter(a.label for a, _ in pairs)
    changes = [_changed(pair, first.question.confidence, margin_ns, len(pairs)) for pair in pairs]
    corrected = correct([change.comparison for change in changes])
    return Compared(
        platform=first.platform,
        deadline_ns=first.question.deadline_ns,
        miss=first.asked.miss,
        changes=tuple(
            replace(change, comparison=comparison, label=_label(a, b, of_several=counts[a.label] > 1))
            for change, comparison, (a, b) in zip(changes, corrected, pairs, strict=True)
        ),
        only_a=tuple(label for match in matches for label in match.only_a),
        only_b=tuple(label for match in matches for label in match.only_b),
        ambiguous=tuple(match.ambiguous for match in matches if match.ambiguous),
        left_out=(*first.left_out, *second.left_out),
    )


@dataclass(frozen=True, kw_only=True)
class _Match:
    """Groups of both sides under the same circumstances: pairs of one target, and the labels of the rest."""

    pairs: tuple[tuple[Group, Group], ...] = ()
    only_a: tuple[str, ...] = ()
    only_b: tuple[str, ...] = ()
    ambiguous: str = ""


def _match(a: Sequence[Group], b: Sequence[Group]) -> _Match:
    pairs = tuple((x, y) for x in a for y in b if _origin(x) == _origin(y))
    if not pairs:
        # The same boards, each with another kernel.
        first, second = _by_board(a), _by_board(b)
        pairs = tuple((first[board], second[board]) for board in first if board in second)
    if not pairs and len(a) == len(b) == 1:
        pairs = ((a[0], b[0]),)
    if a and b and not pairs:
        targets = [" and ".join(_origin_text(group) for group in side) for side in (a, b)]
        return _Match(ambiguous=f"{a[0].label}: {targets[0]} in A, {targets[1]} in B: no target is in both")
    only_a, only_b = (
        tuple(_label(group, group, of_several=len(side) > 1) for group in side if group.key not in matched)
        for side, matched in ((a, {x.key for x, _ in pairs}), (b, {y.key for _, y in pairs}))
    )
    return _Match(pairs=pairs, only_a=only_a, only_b=only_b)


def _by_board(groups: Sequence[Group]) -> dict[tuple[str, int], Group]:
    """The groups of boards that have one group each, by board and width of the bins."""
    found: dict[tuple[str, int], list[Group]] = {}
    for group in groups:
        for board in group.boards:
            found.setdefault((board, _origin(group)[1]), []).append(group)
    return {board: of_board[0] for board, of_board in found.items() if len(of_board) == 1}


def _by_circumstances(side: Study, as_in_2014: set[str]) -> dict[str, list[Group]]:
    """Groups that measured something, by suite, series and parameters.

    For the suites in `as_in_2014`, take the groups of the series of 2014, and those of runs without such a series.
    """
    groups: dict[str, list[Group]] = {}
    of_2014 = [group for group in side.as_in_2014 if group.suite in as_in_2014]
    covered = {run for group in of_2014 for run in group.runs}
    judged = [g for g in side.groups if not (g.suite in as_in_2014 and covered.issuperset(g.runs))]
    for group in (*judged, *of_2014):
        if group.blocks:
            groups.setdefault(json.dumps([group.suite, group.series, sorted(group.parameters.items())]), []).append(
                group
            )
    return groups


def _origin(group: Group) -> tuple[str, int]:
    """What else distinguishes groups: target, width of the bins."""
    first = group.digests[0]
    return group.target, first.histogram.bin_ns


def _origin_text(group: Group) -> str:
    return group.target or "an unknown target"


def _label(a: Group, b: Group, *, of_several: bool) -> str:
    """The name of a pair; if several are alike, with the target, or with the board if two kernels are compared."""
    if not of_several:
        return a.label
    return f"{a.label} on {_origin_text(a) if a.target == b.target else ', '.join(a.boards)}"


def _miss(a: Group, b: Group) -> str | None:
    if a.question is None or b.question is None:
        return None
    return a.question.miss if a.question == b.question else f"{a.question.miss} in A, {b.question.miss} in B"


def _changed(pair: tuple[Group, Group], confidence: float, margin_ns: float | None, tests: int) -> Changed:
    a, b = pair
    figures = pool_figures(a.digests), pool_figures(b.digests)
    return Changed(
        label=a.label,
        comparison=compare(
            a.blocks,
            b.blocks,
            confidence=confidence,
            margin_ns=margin_ns,
            clock_step_ns=max(a.clock_step_ns, b.clock_step_ns),
            tests=tests,
        ),
        p999_ns=(figures[0].percentiles_ns.get(99.9), figures[1].percentiles_ns.get(99.9)),
        max_ns=(figures[0].max_ns, figures[1].max_ns),
        miss=_miss(a, b),
        misses=ratio_of_misses(a.verdict, b.verdict, confidence) if a.verdict and b.verdict else None,
        runs=(a.runs, b.runs),
    )
