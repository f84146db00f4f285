"""The command ``rtrun``."""

import os
import sys
from collections.abc import Sequence

from rtfiles.start import start

# In the order of --help.
GROUPS = {
    "measure": ("quick", "observe", "plan", "run", "influence"),
    "prepare a target": ("new_target", "probe", "check_rt", "build_suites"),
    "judge": ("report", "verdict", "gate", "why", "compare", "show", "verify", "claims", "import_"),
    "long term": ("archive", "history", "trends", "bisect", "site", "farm", "notify"),
}
COMMANDS = tuple(name for names in GROUPS.values() for name in names)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``rtrun``; see `rtfiles.command.dispatch` for the exit status."""
    # Before numpy is imported: our matrices are small, and threads of BLAS that wait for each other take more processor
    # time than the work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return start("rtrun", "Measure a ROS system's real-time behaviour on a target.", GROUPS, argv)


if __name__ == "__main__":
    sys.exit(main())
