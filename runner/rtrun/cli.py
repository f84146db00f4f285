"""The command ``rtrun``."""

import sys
from collections.abc import Sequence
from types import ModuleType

from rtfiles.command import dispatch
from rtrun.commands import (
    archive,
    bisect,
    check_rt,
    claims,
    compare,
    gate,
    history,
    import_,
    new_target,
    plan,
    probe,
    report,
    run,
    show,
    site,
    trends,
    verdict,
    verify,
    why,
)

COMMANDS: tuple[ModuleType, ...] = (
    plan,
    run,
    new_target,
    probe,
    check_rt,
    show,
    verify,
    verdict,
    why,
    report,
    gate,
    compare,
    claims,
    import_,
    archive,
    history,
    trends,
    bisect,
    site,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``rtrun``; see `rtfiles.command.dispatch` for the exit status."""
    return dispatch("rtrun", "Measure a ROS system's real-time behaviour on a target.", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
