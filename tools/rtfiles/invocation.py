"""How the user starts the programs, for messages that name the next command."""

import shlex
import shutil
import sys
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "meta-rt-tests"  # the name in pyproject.toml


def install_extra(name: str) -> str:
    """The command that installs the packages of an extra of pyproject.toml next to the running program.

    It names the packages themselves, because the project is not on the package index: whoever registered its name there
    could run code on the machine of everybody who followed such a command.
    """
    required = (requirement.partition(";") for requirement in metadata.requires(DISTRIBUTION) or ())
    packages = [package.strip() for package, _, marker in required if f'extra == "{name}"' in marker.replace("'", '"')]
    return shlex.join([sys.executable, "-m", "pip", "install", *packages])


def as_called(program: str) -> str:
    """A program of this project as the user must type it: its name, or its path if the shell would not find it.

    The programs are next to each other, so the path begins like that of the running program: `.venv/bin/rtrun`.
    """
    path = Path(sys.argv[0]).with_name(program)
    found = shutil.which(program)
    if not path.is_file() or (found and path.samefile(found)):
        return program
    return str(path)
