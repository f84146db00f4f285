"""How the user starts the programs, for messages that say which command comes next."""

import shlex
import shutil
import sys
from pathlib import Path

DISTRIBUTION = "meta-rt-tests"  # the name in pyproject.toml


def install_extra(name: str) -> str:
    """The command that installs an extra of pyproject.toml beside the running program."""
    return f"{shlex.quote(sys.executable)} -m pip install '{DISTRIBUTION}[{name}]'"


def as_called(program: str) -> str:
    """A program of this project as the user has to write it: its name, or its path where the shell would not find it.

    The programs stand beside each other, so that path begins as the one of the running program: `.venv/bin/rtrun`.
    """
    path = Path(sys.argv[0]).with_name(program)
    found = shutil.which(program)
    if not path.is_file() or (found and path.samefile(found)):
        return program
    return str(path)
