"""The state of a course, by the last change of each of its figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from rtrun.analysis.comparison.history import LEAST_BOOTS
from rtrun.archive.courses import Course
from rtrun.archive.trends import Trend

JUDGED_FROM = LEAST_BOOTS + 1  # the first boot that is held against a history
HISTORY = f"a history takes {LEAST_BOOTS} boots, and boot {JUDGED_FROM} is the first that is judged"
TEXTS = {
    "WORSE": "got worse",
    "BETTER": "got better",
    "KNOWN": "got worse, which is known",
    "ACCEPTED": "got worse, which was accepted",
    "STEADY": "stayed the same",
    "NEW": f"cannot be judged yet: {HISTORY}",
}
"""The words for states, gravest first, and their meaning in a sentence."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CourseState:
    """The judgement of a course: `word`, the figures it is about, the class of its style, and its mark."""

    word: str
    style: str
    mark: str
    figures: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The word and the figures."""
        word = "WORSE, known" if self.word == "KNOWN" else self.word
        return f"{word}: {', '.join(self.figures)}" if self.figures else word


def state_of(course: Course, trends: Sequence[Trend]) -> CourseState:
    """WORSE where a figure's last change made it so; NEW where there are too few boots to see a change."""
    last = {trend.figure: trend for trend in trends}
    worse = tuple(figure for figure, trend in last.items() if trend.is_worse)
    if worse and all(last[figure].known for figure in worse):
        return CourseState(word="KNOWN", style="more", mark="✗", figures=worse)
    if worse:
        return CourseState(word="WORSE", style="refuted", mark="✗", figures=worse)
    if accepted := tuple(figure for figure, trend in last.items() if trend.accepted):
        return CourseState(word="ACCEPTED", style="proven", mark="✓", figures=accepted)
    if last:
        return CourseState(word="BETTER", style="proven", mark="✓", figures=(*last,))
    if len(course.boots()) < JUDGED_FROM:
        return CourseState(word="NEW", style="more", mark="?")
    return CourseState(word="STEADY", style="proven", mark="✓")
