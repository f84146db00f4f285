"""The command ``rtgen``."""

import sys
from collections.abc import Sequence

from rtfiles.start import start

# In the order of --help.
COMMANDS = ("board", "doctor", "explain", "flash", "kconfig", "kernel", "new_profile", "profiles", "render", "suites")


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``rtgen``; see `rtfiles.command.dispatch` for the exit status."""
    return start("rtgen", "Generate images, kernels and the emulated board.", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
