"""The start of both programs. It imports as little as can be, so that nothing of ours runs before Ctrl-C is seen to."""

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from types import ModuleType


def start(prog: str, description: str, groups: Mapping[str, Sequence[str]], argv: Sequence[str] | None) -> int:
    """Import the commands of a program, modules of ``<prog>.commands``, run one, and return the exit status.

    `groups`: the modules by the title under which --help lists them.

    Ctrl-C while they are imported ends the process as it ends a program that knows nothing of signals: an import that
    is interrupted leaves a traceback, and nothing is to be cleaned up yet. In the 20 ms before this is called, while
    Python sets itself up and pip's script imports us, it leaves Python's own traceback: no line of ours has run.
    """
    # pydantic would look for plugins in every package that is installed.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    before = signal.getsignal(signal.SIGINT)
    # One that is ignored, or that a caller has taken for itself, stays.
    quiet = before is signal.default_int_handler
    if quiet:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from rtfiles.command import dispatch

        word = [*(sys.argv[1:] if argv is None else argv)][:1]
        commands = [name for names in groups.values() for name in names]
        asked = [name for name in commands if [name.rstrip("_").replace("_", "-")] == word]
        modules = commands_of(prog, asked or commands)  # --help, and what says that a word is wrong, name all of them
    finally:
        if quiet:
            signal.signal(signal.SIGINT, before)
    return dispatch(prog, description, modules, argv, groups)


def commands_of(prog: str, names: Sequence[str]) -> list[ModuleType]:
    """The commands of a program as `rtfiles.command.dispatch` takes them."""
    return [import_module(f"{prog}.commands.{name}") for name in names]
