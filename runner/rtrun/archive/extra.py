"""The packages that only an archive needs: the extra `archive` of this project."""

from importlib.util import find_spec

from rtfiles.errors import UsageError
from rtfiles.invocation import install_extra

PACKAGES = ("fsspec", "pyarrow", "ruptures")


def check_extra() -> None:
    """Raise UsageError with the command that installs the extra when its packages are missing."""
    if missing := [name for name in PACKAGES if find_spec(name) is None]:
        raise UsageError(f"an archive needs {', '.join(missing)}: {install_extra('archive')}")
