"""What to change about a culprit: remedies.yml."""

import functools
import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator

from rtfiles.config import Config, load_own
from rtrun.causes.parts import Kind
from rtrun.targets.inspection.rt_readiness import with_safety_net

DATA = Path(__file__).with_suffix(".yml")


class Remedy(Config):
    """One entry of the file. `kinds` are names of `Kind`; empty: all. The change removes the `safety_net`."""

    kinds: list[str] = Field(default_factory=list)
    name: str = ""
    change: str
    safety_net: str = ""
    source: str

    @property
    def advice(self) -> str:
        """The change, and what safety it costs."""
        return with_safety_net(self.change, self.safety_net)

    @field_validator("kinds")
    @classmethod
    def _known(cls, kinds: list[str]) -> list[str]:
        if unknown := set(kinds) - set(Kind.__members__):
            raise ValueError(f"unknown: {', '.join(sorted(unknown))}; known: {', '.join(Kind.__members__)}")
        return kinds

    @field_validator("name")
    @classmethod
    def _expression(cls, name: str) -> str:
        re.compile(name)
        return name


class Remedies(Config):
    """remedies.yml."""

    schema_number: Literal[1] = Field(alias="schema")
    remedies: list[Remedy]


@functools.cache
def read_remedies() -> tuple[Remedy, ...]:
    """Read remedies.yml."""
    return tuple(load_own(DATA, Remedies).remedies)


def remedy(kind: Kind, name: str) -> Remedy | None:
    """The first remedy that fits a culprit; None if none fits."""
    fits = (candidate for candidate in read_remedies() if not candidate.kinds or kind.name in candidate.kinds)
    return next((candidate for candidate in fits if re.search(candidate.name, name)), None)
