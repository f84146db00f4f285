"""What is known about each middleware without a target: `<name>.yml` next to this module.

A suite determines what is measured, a middleware through what. The work on a target for a middleware is in
`rtrun.execution.middleware`.
"""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from rtfiles.config import Config, load_own

NONE = "none"
"""The middleware of a baseline: nothing is between the kernel and what is measured."""
DEFAULT = "roscpp"
"""The middleware of a suite if none is named: that of 2014."""

Names = Annotated[tuple[str, ...], Field(strict=False)]


class Middleware(Config):
    """One middleware: how its programs are called and started."""

    summary: str
    kinds: Names = ()
    """The kinds of measurement that it has programs for."""
    executable: str = "{program}_{middleware}"
    """The name of its version of a suite's program."""
    environment: dict[str, str] = Field(default_factory=dict)
    """The environment of its programs; `{ros_master_port}` is the port on the target."""
    repeated: Names = ()
    """Further arguments of a program that runs once per subscriber, `{number}`; `{token}` is unique to an attempt."""
    threads: str = ""
    """Where its own threads get policy, priority and CPUs from; empty: it has no threads of its own."""
    stands_on: dict[str, Names] = Field(default_factory=dict)
    """By kind of measurement: the middlewares below it, to which it adds its own cost; none: the system alone."""

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
