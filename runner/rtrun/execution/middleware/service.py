"""The service that the programs of a middleware need on a target, and what the runner asks it."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Protocol

from rtrun.targets.inspection.facts import Installed
from rtrun.targets.link import Link


class Running(Protocol):
    """Keeps a service running while the context lasts or a run goes on; yields whether the service is ours.

    `owner` distinguishes it from the service of another campaign. With `priority` it runs under FIFO at that priority.
    """

    def __call__(
        self,
        link: Link,
        scripts: PurePosixPath,
        installed: Installed,
        owner: str,
        priority: int | None,
        may_run_go_on: Callable[[], bool],
    ) -> AbstractContextManager[bool]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """What must run on a target for the programs of a middleware."""

    name: str
    """Its name in messages to the user."""
    running: Running
    identity: Callable[[Link], str | None]
    """Tells the running service from one that was started later; None: it does not run."""
    count_subscribers: Callable[[Link, str], int]
    """How many subscribers of an attempt are connected. The token identifies the attempt."""
