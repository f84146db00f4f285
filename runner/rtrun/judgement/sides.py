"""The runs of one campaign, taken apart into the two sides of a comparison.

Sides are two of its variants or middlewares, its two kernels, or runs without and with traces.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

from rtfiles.errors import UsageError
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.run import UNTRACED, KernelName
from rtrun.plan.suites import Value, options

By = Literal["variant", "kernel", "trace", "middleware"]
"""What the two sides differ in: a circumstance of their runs."""


def names_of_sides(study: Study, by: By) -> list[str]:
    """The sides that were measured: variants in the order of the campaign file, the standard kernel before rt.

    Runs without traces come before those with them, the default middleware before others.
    """
    if by == "kernel":
        return [kernel for kernel in get_args(KernelName) if any(record.kernel == kernel for record in study.records)]
    if by == "trace":
        limits = {record.trace for record in study.records if record.trace}
        return sorted(limits, key=lambda limit: (limit != UNTRACED, limit))
    if by == "middleware":
        measured = {group.parameters.get("middleware") for group in study.groups}
        return [name for name in middlewares() if name in measured]
    # The number in a run's name gives the order of the file.
    runs = sorted((record.run, record.variant) for record in study.records if record.variant)
    return list(dict.fromkeys(variant for _, variant in runs))


def split(study: Study, by: By | None = None, names: Sequence[str] = ()) -> tuple[tuple[str, str], tuple[Study, Study]]:
    """The names of two sides and what each of them measured. `names` chooses two where there are more.

    Without `by` the sides are variants if there are any, else kernels. A parameter in which the two sides have no value
    in common is part of the side, so it is removed from their groups; groups that differ only in it then have the same
    parameters. Raises UsageError when there are no two sides.
    """
    if by is None:
        by = "variant" if names or names_of_sides(study, "variant") else "kernel"
    known = names_of_sides(study, by)
    chosen = list(names) or known
    if len(chosen) != 2 or len(set(chosen)) != 2 or not set(chosen) <= set(known):
        holds = f"the {by}s {', '.join(known)}" if known else f"no {by}s of a campaign"
        raise UsageError(
            f"{study.source.path}: holds {holds}: give a second folder to compare with, or two {by}s with --sides"
        )
    sides = [_groups_of(study.groups, by, name) for name in chosen]
    varying = {
        key
        for key in {key for side in sides for group in side for key in group.parameters}
        if _values(sides[0], key).isdisjoint(_values(sides[1], key))
    }
    if by == "middleware":  # what only one of the two knows
        varying |= {key for key, option in options().items() if not all(map(option.is_taken_through, chosen))}
    first, second = (
        replace(
            study,
            groups=tuple(_without(group, varying) for group in _groups_of(study.groups, by, name)),
            groups_2014=tuple(_without(group, varying) for group in _groups_of(study.groups_2014, by, name)),
        )
        for name in chosen
    )
    return (chosen[0], chosen[1]), (first, replace(second, left_out=()))


def _groups_of(groups: Sequence[Group], by: By, name: str) -> list[Group]:
    return [group for group in groups if group.parameters.get(by) == name]


def _values(groups: Sequence[Group], key: str) -> set[Value]:
    return {group.parameters.get(key) for group in groups}


def _without(group: Group, keys: set[str]) -> Group:
    return replace(group, parameters={key: value for key, value in group.parameters.items() if key not in keys})
