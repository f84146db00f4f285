"""What rtgen reads: folders that the Python package holds too; and the repository, into which it renders."""

from pathlib import Path

from rtfiles.errors import UsageError

# Links to folders of the repository, which become copies in the Python package.
SHIPPED = Path(__file__).with_name("shipped")


def shipped(name: str) -> Path:
    """The folder ``kconfig`` or ``recipes-tests``: that of the repository where there is one."""
    return (SHIPPED / name).resolve()


def checkout() -> Path:
    """The top folder of the repository. Raises UsageError where only the Python package is installed."""
    top = Path(__file__).resolve().parents[2]
    if shipped("kconfig").parent != top:
        raise UsageError("this writes into a checkout of meta-rt-tests, and here is the Python package alone")
    return top
