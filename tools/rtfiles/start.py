"""The start of both programs. It imports very little, so that Ctrl-C is handled before any code of ours runs."""

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from types import ModuleType


def start(prog: str, description: str, groups: Mapping[str, Sequence[str]], argv: Sequence[str] | None) -> int:
    """Import the commands of a program, modules of ``<prog>.commands``, run one, and return the exit status.

    `groups`: the modules by the title under which --help lists them.

    During the imports, Ctrl-C ends the process like a program without signal handlers: an interrupted import would
    print a traceback, and there is nothing to clean up yet. In the 20 ms before this call, while Python starts and
    pip's script imports us, Ctrl-C prints Python's own traceback: no line of ours has run.
    """
    # Otherwise pydantic searches every installed package for plugins.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    before = signal.getsignal(signal.SIGINT)
    # Keep a handler that the caller has set, and an ignored signal.
    quiet = before is signal.default_int_handler
    if quiet:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from rtfiles.command import called_as, dispatch

        word = [*(sys.argv[1:] if argv is None else argv)][:1]
        commands = [name for names in groups.values() for name in names]
        asked = [name for name in commands if [called_as(name)] == word]
        modules = commands_of(prog, asked or commands)  # --help and the error for a wrong word name all of them
    finally:
        if quiet:
            signal.signal(signal.SIGINT, before)
    return dispatch(prog, description, modules, argv, groups)


def commands_of(prog: str, names: Sequence[str]) -> list[ModuleType]:
    """The commands of a program in the form for `rtfiles.command.dispatch`."""
    return [import_module(f"{prog}.commands.{name}") for name in names]
