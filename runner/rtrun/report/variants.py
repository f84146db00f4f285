"""The variants of one interleaved campaign, taken apart into the two sides of a comparison."""

from collections.abc import Sequence
from dataclasses import replace

from rtfiles.errors import UsageError
from rtrun.plan.suites import Value
from rtrun.report.study import Group, Study


def variant_names(study: Study) -> list[str]:
    """The variants that were measured, in the order of the campaign file: the number of a run's name tells it."""
    runs = sorted((record.run, record.variant) for record in study.records if record.variant)
    return list(dict.fromkeys(variant for _, variant in runs))


def split_variants(study: Study, names: Sequence[str] = ()) -> tuple[tuple[str, str], tuple[Study, Study]]:
    """The names of two variants and what each of them measured. `names` chooses two where there are more.

    Their groups have no parameter in which the two variants have no value in common: it is what makes the variant. So
    groups that differ in it alone have the same parameters. Raises UsageError when there are no two variants.
    """
    known = variant_names(study)
    chosen = list(names) or known
    if len(chosen) != 2 or len(set(chosen)) != 2 or not set(chosen) <= set(known):
        raise UsageError(
            f"{study.source.path}: holds {'the variants ' + ', '.join(known) if known else 'no variants'}: "
            "give a second folder to compare with, or two variants with --variants"
        )
    sides = [_groups_of(study.groups, name) for name in chosen]
    varying = {
        key
        for key in {key for side in sides for group in side for key in group.parameters}
        if _values(sides[0], key).isdisjoint(_values(sides[1], key))
    }
    first, second = (
        replace(
            study,
            groups=tuple(_without(group, varying) for group in _groups_of(study.groups, name)),
            groups_2014=tuple(_without(group, varying) for group in _groups_of(study.groups_2014, name)),
        )
        for name in chosen
    )
    return (chosen[0], chosen[1]), (first, replace(second, left_out=()))


def _groups_of(groups: Sequence[Group], variant: str) -> list[Group]:
    return [group for group in groups if group.parameters.get("variant") == variant]


def _values(groups: Sequence[Group], key: str) -> set[Value]:
    return {group.parameters.get(key) for group in groups}


def _without(group: Group, keys: set[str]) -> Group:
    return replace(group, parameters={key: value for key, value in group.parameters.items() if key not in keys})
