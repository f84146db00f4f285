"""The command ``rtgen``."""

import sys
from collections.abc import Sequence

from rtfiles.start import start

# In the order of --help.
GROUPS = {
    "boards and suites": ("board", "suites", "flash"),
    "images by BitBake": ("profiles", "explain", "new_profile", "render", "doctor"),
    "kernels": ("kconfig", "kernel"),
}
COMMANDS = tuple(name for names in GROUPS.values() for name in names)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``rtgen``; see `rtfiles.command.dispatch` for the exit status."""
    return start("rtgen", "Generate images, kernels and the emulated board.", GROUPS, argv)


if __name__ == "__main__":
    sys.exit(main())
