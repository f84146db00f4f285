"""What rtgen reads: folders that the Python package also contains, and the repository that it renders into."""

from pathlib import Path

from rtfiles.errors import UsageError

# Links to folders of the repository; the Python package has copies of the folders.
SHIPPED = Path(__file__).with_name("shipped")


def shipped(name: str) -> Path:
    """The folder ``kconfig`` or ``recipes-tests``, in the repository if there is one."""
    return (SHIPPED / name).resolve()


def checkout() -> Path:
    """The top folder of the repository. Raises UsageError where only the Python package is installed."""
    top = Path(__file__).resolve().parents[2]
    if shipped("kconfig").parent != top:
        raise UsageError("this writes into a checkout of meta-rt-tests, and here is the Python package alone")
    return top
