"""What the programs of a middleware need to run on a target beside them, and what is asked of it."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Protocol

from rtrun.targets.inspection.facts import Installed
from rtrun.targets.link import Link


class Running(Protocol):
    """Sees to it that a service runs while the context lasts, or a run goes on; it yields whether it is ours.

    `owner` tells ours from that of another campaign. With `priority` it runs under FIFO at that priority.
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
    """What a message to the user calls it."""
    running: Running
    identity: Callable[[Link], str | None]
    """Tells one that runs from another that was started later; None: it does not run."""
    count_subscribers: Callable[[Link, str], int]
    """How many subscribers of an attempt, told by its token, are connected."""
