"""The processes of programs on the target: found and ended by the functions of on_target/processes.sh.

These functions decide which processes belong to a program, because a number alone is not enough: the number of an ended
process is reused, a file or an answer that was cut short holds a wrong number, and ``kill -- -1`` ends everything.
"""

from pathlib import Path

_SCRIPT = Path(__file__).parents[1] / "on_target/processes.sh"
# The first lines of a script that searches for processes or ends some; without comments, as they are sent each time.
FUNCTIONS = "".join(
    line for line in _SCRIPT.read_text(encoding="utf-8").splitlines(keepends=True) if not line.lstrip().startswith("#")
)
