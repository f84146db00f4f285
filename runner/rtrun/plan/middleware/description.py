"""What is known of each middleware without a target: `<name>.yml` beside this module.

A suite says what is measured, a middleware through what. What is done on a target for one is in
`rtrun.execution.middleware`.
"""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from rtfiles.config import Config, load_own

NONE = "none"
"""Of a baseline: nothing stands between the kernel and what is measured."""
DEFAULT = "roscpp"
"""Of a suite, where nobody names one: that of 2014."""

Names = Annotated[tuple[str, ...], Field(strict=False)]


class Middleware(Config):
    """One middleware: how its programs are called and started."""

    summary: str
    kinds: Names = ()
    """The kinds of measurement that it has programs for."""
    executable: str = "{program}_{middleware}"
    """What its form of a suite's program is called."""
    environment: dict[str, str] = Field(default_factory=dict)
    """Of its programs; `{ros_master_port}` is that of the target."""
    repeated: Names = ()
    """Further arguments of a program that runs once per subscriber, `{number}`; `{token}` is unique to an attempt."""
    threads: str = ""
    """From what threads of its own take policy, priority and CPUs; empty: it has none."""
    stands_on: dict[str, Names] = Field(default_factory=dict)
    """Of each kind of measurement the middlewares below it, to which it adds what it costs; none: the system alone."""

    def environment_with(self, **values: object) -> tuple[tuple[str, str], ...]:
        """The environment of its programs with these values filled in."""
        return tuple((name, text.format_map(values)) for name, text in self.environment.items())


def middleware_names() -> tuple[str, ...]:
    """The name of every middleware, the default one first."""
    names = (path.stem for path in Path(__file__).parent.glob("*.yml"))
    return tuple(sorted(names, key=lambda name: (name != DEFAULT, name)))


@functools.cache
def middlewares() -> Mapping[str, Middleware]:
    """Every middleware by its name, the default one first."""
    return {name: load_own(Path(__file__).with_name(f"{name}.yml"), Middleware) for name in middleware_names()}
