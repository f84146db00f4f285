"""README.md and the pages of docs/: which there are, their commands, and the files that they let the reader write.

A command is an indented line, or a part of a sentence in backquotes, that begins with rtgen or rtrun. Fenced blocks are
for tests of their own.
"""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

import rtgen.cli
import rtrun.cli
from rtfiles.command import called_as
from rtfiles.start import commands_of

TOP = Path(__file__).parents[1]
PAGES = [TOP / "README.md", *sorted((TOP / "docs").rglob("*.md"))]
COMMANDS = {name: commands_of(name, cli.COMMANDS) for name, cli in (("rtgen", rtgen.cli), ("rtrun", rtrun.cli))}


def name_of(page: Path) -> str:
    return str(page.relative_to(TOP))


def blocks(page: Path) -> Iterator[str]:
    """The commands of the indented lines of a page in their order, without the remark that follows some."""
    return (command for line in lines_of(page) if (command := command_of(line)))


def commands(page: Path) -> Iterator[str]:
    """Those, and the commands in sentences."""
    for line in lines_of(page):
        if line.startswith("    "):
            if command := command_of(line):
                yield command
            continue
        for command in re.findall(r"`(?:\.venv/bin/)?((?:rtgen|rtrun) [^`]+)`", line):
            program, name, *rest = command.split()
            if rest and any(name == called_as(module.__name__) for module in COMMANDS[program]):
                yield command


def lines_of(page: Path) -> list[str]:
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S).splitlines()


def command_of(line: str) -> str | None:
    if not line.startswith("    "):
        return None
    command = re.split(r"\s{2,}|\s#", line.strip())[0].removeprefix("$ ").removeprefix(".venv/bin/")
    return command if command.partition(" ")[0] in COMMANDS else None


def file_of(page: Path, name: str) -> str:
    """A file that a page lets the reader write."""
    return textwrap.dedent(page.read_text().partition(f"rite `{name}`:\n\n")[2].partition("\n\n")[0]) + "\n"
