"""How the user starts the programs, for messages that say which command comes next."""

import shlex
import shutil
import sys
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "meta-rt-tests"  # the name in pyproject.toml


def install_extra(name: str) -> str:
    """The command that installs the packages of an extra of pyproject.toml beside the running program.

    It names the packages themselves. The project is not on the package index: whoever registered its name there would
    run code of theirs on the machine of everybody who followed such a command.
    """
    required = (each.partition(";") for each in metadata.requires(DISTRIBUTION) or ())
    packages = [package.strip() for package, _, marker in required if f'extra == "{name}"' in marker.replace("'", '"')]
    return shlex.join([sys.executable, "-m", "pip", "install", *packages])


def as_called(program: str) -> str:
    """A program of this project as the user has to write it: its name, or its path where the shell would not find it.

    The programs are next to each other, so that path begins as the one of the running program: `.venv/bin/rtrun`.
    """
    path = Path(sys.argv[0]).with_name(program)
    found = shutil.which(program)
    if not path.is_file() or (found and path.samefile(found)):
        return program
    return str(path)
