"""The command ``rtrun``."""

import os
import sys
from collections.abc import Sequence

from rtfiles.start import start

# In the order of --help.
COMMANDS = (
    "quick",
    "plan",
    "run",
    "observe",
    "new_target",
    "build_suites",
    "probe",
    "check_rt",
    "show",
    "verify",
    "verdict",
    "why",
    "report",
    "gate",
    "compare",
    "claims",
    "import_",
    "archive",
    "history",
    "trends",
    "bisect",
    "site",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``rtrun``; see `rtfiles.command.dispatch` for the exit status."""
    # Before numpy is imported: our matrices are small, and threads of BLAS that wait for each other take more processor
    # time than the work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return start("rtrun", "Measure a ROS system's real-time behaviour on a target.", COMMANDS, argv)


if __name__ == "__main__":
    sys.exit(main())
