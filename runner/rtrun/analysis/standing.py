"""How far one group of runs is from a sure answer to the goal of its campaign."""

from dataclasses import dataclass

from rtrun.analysis.deadline import Answer, Verdict


@dataclass(frozen=True, kw_only=True, slots=True)
class Standing:
    """A group of similar runs and its verdict so far; if there can be none, `undecidable` says why.

    `has_deadline`: there is a question to answer. `measured_s` is the time that its runs took, in seconds.
    """

    label: str
    runs: tuple[str, ...]
    verdict: Verdict | None
    undecidable: str | None
    measured_s: float
    has_deadline: bool = True
    boards: frozenset[str] = frozenset()
    """The names of the boards that it was measured on."""
    observed_by: tuple[str, ...] = ()
    """For an observed stream: the runs of the campaign that observed it."""
    short: str = ""
    """A shorter name than `label`, for a table."""
    stream: str = ""
    """Which stream that is."""

    @property
    def planned(self) -> tuple[str, ...]:
        """The runs that the campaign planned: those that observed the group's streams, or else its own."""
        return self.observed_by or self.runs

    @property
    def answer(self) -> Answer:
        """The answer of the verdict."""
        if not self.has_deadline:
            return Answer.NO_DEADLINE
        return Answer.NO_STATEMENT if self.verdict is None else self.verdict.answer

    @property
    def is_final(self) -> bool:
        """Whether no further measuring is needed, or none would change the answer."""
        return self.answer is not Answer.NEEDS_MORE or (self.verdict is not None and bool(self.verdict.lost))
