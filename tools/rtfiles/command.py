"""The entry of both programs: parse the arguments, run a command, turn errors into exit statuses."""

import argparse
import contextlib
import errno
import shutil
import signal
import sys
import textwrap
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from rtfiles.errors import DEFECT_STATUS, INTERRUPTED_STATUS, InfrastructureError, UsageError
from rtfiles.invocation import DISTRIBUTION
from rtfiles.output import print_error, print_line, print_status, print_text, quietly, surviving_output
from rtfiles.wording import did_you_mean, unknown

SHELLS = ("bash", "zsh")
# The placeholder for a command, if the help lists the commands in groups.
LISTED = "listed_command"


def dispatch(
    prog: str,
    description: str,
    commands: Sequence[ModuleType],
    argv: Sequence[str] | None,
    groups: Mapping[str, Sequence[str]] | None = None,
) -> int:
    """Run one sub-command and return the exit status.

    A command is a module with ``HELP``, ``EXAMPLES``, ``add_arguments(parser)`` and ``run(args) -> int``. ``FAILS`` is
    the meaning of the exit status 1, for a command that can return it. Slow imports belong inside ``run``, so that
    ``--help`` answers at once.

    The exit status does not change when the reader of standard output goes away. If standard output cannot be written
    for another reason, for example a full disk, the status is that of an infrastructure error, unless the command
    failed with its own status. SIGTERM and SIGHUP end a command like Ctrl-C, so that it cleans up.
    """
    with surviving_output() as losses, _interruptible():
        try:
            args = parser_of(prog, description, commands, groups).parse_args(argv)
            try:
                with quietly(args.quiet):
                    status = int(args.run(args))
            finally:
                print_status("")
        except SystemExit as end:  # the parser has printed the help, or what is wrong with the arguments
            status = int(end.code or 0)
        except (UsageError, InfrastructureError) as error:
            status = error.exit_status
            for line in str(error).splitlines():
                print_error(f"{prog}: {line}")
        except KeyboardInterrupt:
            status = INTERRUPTED_STATUS
            print_error(f"{prog}: interrupted")
        except OSError as error:
            status = InfrastructureError.exit_status
            where = f"{error.filename}: " if error.filename else ""
            print_error(f"{prog}: {where}{error.strerror or error}")
        except Exception:
            status = DEFECT_STATUS
            for line in traceback.format_exc().splitlines():
                print_error(line)
            print_error(f"{prog}: a defect of {prog}; please report it with the lines above")
        if losses.stdout and losses.stdout.errno != errno.EPIPE:
            print_error(f"{prog}: standard output: {losses.stdout.strerror}")
            status = status or InfrastructureError.exit_status
        return status


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt; one that the caller ignores (as nohup does) stays ignored."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) != signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread():  # handlers can be set only there
        numbers = []
    previous = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def called_as(module: str) -> str:
    """The word for a command, from the name of its module, which cannot have a dash or be called import."""
    return module.rpartition(".")[2].rstrip("_").replace("_", "-")


def parser_of(
    prog: str,
    description: str,
    commands: Sequence[ModuleType],
    groups: Mapping[str, Sequence[str]] | None = None,
) -> argparse.ArgumentParser:
    """The parser of a program with these commands; with `groups`, --help lists the commands below group titles."""
    parser = _Parser(prog=prog, description=description)
    parser.add_argument("--version", action=_PrintVersion, nargs=0, help="print the version")
    parser.add_argument(
        "--print-completion", action=_PrintCompletion, choices=SHELLS, help="print the completion script of a shell"
    )
    parser.add_argument(
        "--print-manual", action=_PrintManual, nargs=0, help=f"print a manual page: {prog} --print-manual | man -l -"
    )
    subparsers = parser.add_subparsers(dest=LISTED if groups else "command", required=True, metavar="COMMAND")
    if groups:
        parser.epilog = _listed(commands, groups)
    for command in commands:
        subparser = subparsers.add_parser(
            called_as(command.__name__), help=command.HELP, description=command.HELP, epilog=_epilog(command)
        )
        command.add_arguments(subparser)
        _add_quiet(subparser)
        subparser.set_defaults(run=command.run)
    return parser


def _listed(commands: Sequence[ModuleType], groups: Mapping[str, Sequence[str]]) -> str:
    """The commands below the titles of their groups, and the meaning of the exit statuses."""
    known = {command.__name__.rpartition(".")[2]: command for command in commands}
    width = max(len(called_as(command.__name__)) for command in commands)
    lines = []
    for title, names in groups.items():
        lines.append(f"{title}:")
        for name in filter(known.get, names):
            text = textwrap.wrap(known[name].HELP, _columns() - width - 4)
            lines += textwrap.indent("\n".join(text), " " * (width + 4)).splitlines()
            lines[-len(text)] = f"  {called_as(name):<{width}}  {text[0]}"
        lines.append("")
    statuses = f"exit status: {_statuses('the answer is no')}"
    return "\n".join([*lines, *textwrap.wrap(statuses, _columns()), "", "COMMAND --help says more, with examples."])


def _epilog(command: ModuleType) -> str:
    """Examples of a command, and the meaning of its exit statuses."""
    examples = [f"  {example}" for example in getattr(command, "EXAMPLES", ())]
    statuses = f"exit status: {_statuses(getattr(command, 'FAILS', None))}"
    return "\n".join([*(["examples:", *examples, ""] if examples else []), *textwrap.wrap(statuses, _columns())])


def _statuses(fails: str | None) -> str:
    known = {
        0: "done",
        1: fails,
        UsageError.exit_status: "the call or what it names is wrong",
        InfrastructureError.exit_status: "a target or a tool failed",
        DEFECT_STATUS: "a defect of the program",
        INTERRUPTED_STATUS: "interrupted",
    }
    return "; ".join(f"{status} {text}" for status, text in known.items() if text)


def _columns() -> int:
    return shutil.get_terminal_size().columns - 2


class _Help(argparse.HelpFormatter):
    """Help that keeps the lines of a text with several, without the commands that the epilog lists."""

    def add_argument(self, action: argparse.Action) -> None:
        if action.dest != LISTED:
            super().add_argument(action)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


class _Parser(argparse.ArgumentParser):
    """A parser that accepts no abbreviated options, and suggests similar words; its sub-parsers do the same.

    Where a command must follow and no word does, it prints its help, with the status of a wrong call: a script that
    calls it with an empty variable must not go on.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"formatter_class": _Help, **settings, "allow_abbrev": False})

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        given = sys.argv[1:] if args is None else args
        if not given and any(isinstance(action, argparse._SubParsersAction) for action in self._actions):
            self.print_help()
            self.exit(UsageError.exit_status)
        known, others = super().parse_known_args(args, namespace)
        if others:
            words = [word.partition("=")[0] for word in others if word.startswith("-")]
            hint = did_you_mean(words, list(self._option_string_actions))
            self.error(f"unknown argument{'s' if others[1:] else ''} {' '.join(others)}{',' if hint else ''}{hint}")
        return known, others

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, unknown("word", value, known=map(str, action.choices)))


def _add_quiet(parser: argparse.ArgumentParser) -> None:
    """Add --quiet to the parser of a command, or to those of its actions."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for subparser in action.choices.values():
                _add_quiet(subparser)
            return
    parser.add_argument("-q", "--quiet", action="store_true", help="neither remarks nor progress")


class _PrintVersion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print_line(f"{parser.prog} {version(DISTRIBUTION)}")
        parser.exit()


class _PrintCompletion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, _namespace: Any, shell: Any, _option: Any = None) -> None:
        import shtab

        _complete_paths(parser)
        print_text(shtab.complete(parser, shell))
        parser.exit()


class _PrintManual(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print_text(manual(parser))
        parser.exit()


def manual(parser: argparse.ArgumentParser) -> str:
    """A manual page for man(7): the --help of the program, and a section with the --help of each command."""
    from importlib.metadata import version

    def shown(text: str) -> str:
        lines = text.replace("\\", "\\e").replace("-", "\\-").splitlines()
        # A line that begins with one of these would be a roff request.
        return "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in lines)

    name = parser.prog
    commands = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction)).choices
    sections = [("DESCRIPTION", parser)] + [(f"{name} {word}", subparser) for word, subparser in commands.items()]
    return "\n".join(
        [
            f'.TH {name.upper()} 1 "" "{DISTRIBUTION} {version(DISTRIBUTION)}"',
            f".SH NAME\n{name} \\- {shown(parser.description or name)}",
            *(f'.SH "{shown(title)}"\n.nf\n{shown(subparser.format_help())}\n.fi' for title, subparser in sections),
        ]
    )


def _complete_paths(parser: argparse.ArgumentParser) -> None:
    """Let a shell complete file names for every path argument, including those of the commands."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for subparser in action.choices.values():
                _complete_paths(subparser)
        elif action.type is Path or getattr(action.type, "__annotations__", {}).get("return") is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
