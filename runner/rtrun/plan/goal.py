"""The goal of a campaign that measures until an answer is certain, as its file states it."""

from typing import Annotated

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from rtfiles.config import Config
from rtrun.kinds.lateness import Of
from rtrun.plan.quantities import read_probability, read_share, read_time_ns
from rtrun.plan.question import BURSTS_MAX, NONE_TOLERATED, THESIS, Question, Tolerance, boots_for, read_tolerance

Time = Annotated[int, BeforeValidator(read_time_ns)]
Probability = Annotated[float, BeforeValidator(read_probability)]


class Goal(Config):
    """``until`` of a campaign: measure until the deadline is proven or refuted, at most for so long."""

    deadline_ns: Time | None = Field(default=None, alias="deadline")
    """None: each observed stream has its own."""
    probability: Probability
    """What P(miss) must stay below."""
    confidence: Probability = THESIS.confidence
    at_most_ns: Time = Field(alias="at_most")
    """Time for everything: runs, the time between them, and restarts."""
    boots: Annotated[int, Field(ge=1, le=1000)] = 1
    """How many boots of the target an answer must be based on; above 1 the target is restarted between rounds.

    A file may also have ``{unlike: 5%}``: as many boots as leave at most this share of different boots unseen.
    """
    bursts: Annotated[int, Field(ge=1, le=BURSTS_MAX)] | None = None
    """The mean length of bursts of misses that a proof must cover, even if none was seen; None: a stall of 10 ms."""
    of: Of | None = None
    """Which values have the deadline; None: those that each suite measures, for the cyclic timer the lateness."""
    tolerate: Annotated[Tolerance, BeforeValidator(read_tolerance)] = NONE_TOLERATED
    """How many values may miss the deadline before it counts, such as ``2 in a row`` or ``3 of 100``."""

    @field_validator("boots", mode="before")
    @classmethod
    def _count_boots(cls, value: object, info: ValidationInfo) -> object:
        if not isinstance(value, dict):
            return value
        if set(value) != {"unlike"}:
            raise ValueError("neither a number of boots nor {unlike: SHARE}, as {unlike: 5%}")
        return boots_for(read_share(value["unlike"]), info.data.get("confidence", THESIS.confidence))

    @property
    def question(self) -> Question:
        """The question to answer."""
        return Question(
            of=self.of,
            tolerance=self.tolerate,
            deadline_ns=self.deadline_ns,
            probability=self.probability,
            confidence=self.confidence,
            boots=self.boots,
            bursts=self.bursts,
        )
