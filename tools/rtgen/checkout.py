"""The repository whose files rtgen reads and renders."""

from pathlib import Path

from rtfiles.errors import UsageError

# Folders that the Python package does not hold.
FOLDERS = ("kconfig", "recipes-tests", "tools/rtgen/templates")


def checkout() -> Path:
    """The top folder of the repository. Raises UsageError where only the Python package is installed."""
    top = Path(__file__).resolve().parents[2]
    if not all((top / folder).is_dir() for folder in FOLDERS):
        raise UsageError("this needs a checkout of meta-rt-tests, not the Python package alone: run make there")
    return top
