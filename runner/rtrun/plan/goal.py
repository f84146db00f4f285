"""The goal of a campaign that measures until an answer is certain, as its file states it."""

from typing import Annotated

from pydantic import BeforeValidator, Field

from rtfiles.config import Config
from rtrun.plan.quantities import read_probability, read_time_ns

Time = Annotated[int, BeforeValidator(read_time_ns)]
Probability = Annotated[float, BeforeValidator(read_probability)]


class Goal(Config):
    """``until`` of a campaign: measure until the deadline is proven or refuted, at most for so long."""

    deadline_ns: Time = Field(alias="deadline")
    probability: Probability
    """What P(miss) must stay below."""
    confidence: Probability = 0.95
    at_most_ns: Time = Field(alias="at_most")
    """Time for all of it: runs, what lies between them, and restarts."""
    boots: Annotated[int, Field(ge=1, le=1000)] = 1
    """How many boots of the target an answer must rest on; above 1 the target is restarted between rounds."""
