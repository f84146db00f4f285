"""What is known about each library with probes, for every target: `<name>.yml` next to this module.

The kernel places a probe at a function (Documentation/trace/uprobetracer.rst). The arguments that it records are
written as tracefs takes them, for each architecture.
"""

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rtfiles.config import Config, load_own, matching

ARCHITECTURES = ("x86_64", "aarch64", "armv7")
Architecture = Literal["x86_64", "aarch64", "armv7"]

# What the kernel is asked to read: a register or a place in memory, and its type.
Fetch = Annotated[
    str,
    matching(
        r"[%$+()\w]{2,60}:(?:[sux](?:8|16|32|64)|string)",
        "an argument as tracefs takes it, with its type, as +0(%di):u64",
    ),
]
_Name = Annotated[str, matching("[a-z][a-z0-9_]{0,23}", "a name in small letters")]


class Halves(Config):
    """A number of 64 bits that two registers hold."""

    low: Fetch
    high: Fetch


class Seconds(Config):
    """A time in nanoseconds, made from its seconds and its nanoseconds."""

    seconds: Fetch
    nanoseconds: Fetch


class Named(Config):
    """A number that stands for a name; a number without a name gives no value."""

    number: Fetch
    names: dict[Annotated[int, Field(strict=False)], str]


class Reduced(Config):
    """A number that is too large by `less`; a number smaller than `less` gives no value."""

    number: Fetch
    less: int


class Bytes(Config):
    """Bytes of a message from its byte number `at` on, as a number; those beyond the value `of` count as 0."""

    number: Fetch
    at: int
    of: str


Argument = Fetch | Halves | Seconds | Named | Reduced | Bytes


class Beside(Config):
    """Another library of the same process, and a symbol in it that distinguishes one release from another."""

    library: str
    symbol: str


class Probe(Config):
    """A function whose calls are an event.

    No probe is placed at a return: it would change the return address on the stack, and a C++ exception that passes
    through the function would then end the program.
    """

    event: _Name
    symbols: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """Names as in the library's symbol table; the probe takes the first that the library has."""
    only_in: str = ""
    """Regular expression of how the file's name begins, where files of a library differ."""
    only_with: Beside | None = None
    only_without: Beside | None = None
    constants: dict[_Name, str | int] = Field(default_factory=dict)
    """Values that every hit has."""
    arguments: dict[Architecture, dict[_Name, Argument]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_arguments(self) -> "Probe":
        for values in self.arguments.values():
            for name, argument in values.items():
                if isinstance(argument, Bytes) and argument.of not in values:
                    raise ValueError(f"{name}: there is no argument {argument.of!r}")
        return self

    def is_in(self, path: str) -> bool:
        """Whether it is for the library of this path."""
        return re.match(self.only_in, path.rpartition("/")[2], re.ASCII) is not None


class Library(Config):
    """A library whose functions show what programs do."""

    summary: str
    file: str
    """Regular expression of the file's name."""
    without: str
    """What it means when one of the symbols is not there."""
    probes: Annotated[tuple[Probe, ...], Field(strict=False)]

    def is_file(self, path: str) -> bool:
        """Whether a path is that of this library."""
        return re.fullmatch(self.file, path.rpartition("/")[2], re.ASCII) is not None


@functools.cache
def libraries() -> Mapping[str, Library]:
    """Every library with probes by its name."""
    return {path.stem: load_own(path, Library) for path in sorted(Path(__file__).parent.glob("*.yml"))}


def events() -> tuple[str, ...]:
    """All events, each once."""
    return tuple(dict.fromkeys(probe.event for library in libraries().values() for probe in library.probes))
