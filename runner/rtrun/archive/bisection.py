"""Which commit or version to measure next, to find the one that made a figure worse."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

from rtrun.analysis.order.change_points import ChangePoint, find_changes
from rtrun.archive.courses import Course, Figure


@dataclass(frozen=True, kw_only=True, slots=True)
class Suspects:
    """A figure that got worse from `good` to `bad`, two measured versions; those `between` them are not measured.

    `change` is the change of the figure over the boots in the order of the versions.
    """

    course: Course
    figure: Figure
    good: str
    bad: str
    between: tuple[str, ...]
    change: ChangePoint

    @property
    def proposal(self) -> str | None:
        """The version in the middle of those between; None where `bad` is the first one that is worse."""
        return self.between[len(self.between) // 2] if self.between else None


def find_suspects(course: Course, fact: str, order: Sequence[str], *, confidence: float) -> list[Suspects]:
    """Where each figure got worse over the versions of a fact, whose `order` is oldest first.

    The boots are put into the order of their versions, so that it does not matter when a version was measured. Boots of
    a version that is not in `order`, or of several versions, are left out.
    """
    places = {version: place for place, version in enumerate(order)}
    runs = sorted(
        (run for run in course.runs if run.facts.get(fact) in places), key=lambda run: places[run.facts[fact]]
    )
    if not runs:
        return []
    # One boot may have measured several versions: each is a unit of its own.
    ordered = replace(course, runs=tuple(replace(run, boot=f"{run.boot} {run.facts[fact]}") for run in runs))
    suspects = []
    for figure in get_args(Figure):
        knowing = ordered.knowing(figure)
        if knowing is None:
            continue
        versions = [places[boot[0].facts[fact]] for boot in knowing.boots()]
        for change in find_changes(knowing.values(figure), confidence=confidence):
            good, bad = versions[change.index - 1], versions[change.index]
            if change.after > change.before and good < bad:
                suspects.append(
                    Suspects(
                        course=course,
                        figure=figure,
                        good=order[good],
                        bad=order[bad],
                        between=tuple(order[good + 1 : bad]),
                        change=change,
                    )
                )
    return suspects
