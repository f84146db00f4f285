"""Which commit or version to measure next, to find the one that made a figure worse."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

from rtrun.analysis.order.change_points import ChangePoint, find_changes
from rtrun.archive.courses import Course, Figure


@dataclass(frozen=True, kw_only=True, slots=True)
class Suspects:
    """A figure that got worse from version `good` to version `bad`; the versions `between` are not measured.

    `change` is the change of the figure over the boots, sorted by version.
    """

    course: Course
    figure: Figure
    good: str
    bad: str
    between: tuple[str, ...]
    change: ChangePoint

    @property
    def proposal(self) -> str | None:
        """The version in the middle of `between`; None where `bad` is the first worse version."""
        return self.between[len(self.between) // 2] if self.between else None


def find_suspects(course: Course, fact: str, order: Sequence[str], *, confidence: float) -> list[Suspects]:
    """Where each figure got worse over the versions of a fact; `order` lists the versions, oldest first.

    The boots are sorted by version, so it does not matter when a version was measured. Boots with a version that is not
    in `order`, or with several versions, are left out.
    """
    places = {version: place for place, version in enumerate(order)}
    runs = sorted(
        (run for run in course.runs if run.facts.get(fact) in places), key=lambda run: places[run.facts[fact]]
    )
    if not runs:
        return []
    # One boot may have measured several versions; each counts separately.
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
