"""How the figures of a report are computed, in the report's words: how.yml."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, load

DATA = Path(__file__).with_suffix(".yml")


class Explanation(Config):
    """One entry of the file."""

    title: str
    paragraphs: list[str]


class _Explanations(Config):
    schema_number: Literal[1] = Field(alias="schema")
    explanations: dict[str, Explanation]


@functools.cache
def explanations() -> Mapping[str, Explanation]:
    """Read how.yml: explanations by the names that tables use."""
    return load(DATA, _Explanations).explanations
