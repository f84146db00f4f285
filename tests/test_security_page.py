"""The limits in docs/security.md are those of the code, and the code says of each whether it is one."""

import re

from docs_table import END
from limits import BEGIN, HEAD, PAGE, constants, rows

# A constant of such a name says what it limits, or behind a plain # what else it is. Ranges of numbers have a module.
BY_NAME = re.compile(r"_?MAX_\w+|\w+_MAX|\w*LIMIT_BYTES")
RANGES = "rtrun.kinds.limits"
# In the rooms that talk to a target so does a time, but for pauses between two attempts and parts of a time.
TIME = re.compile(r"\w+_S")
TIMED = ("rtrun.targets.", "rtrun.execution.")
PAUSES = re.compile(
    r"_?(POLL|FOLLOW|LOOK|RETRY|WAIT|SLICE|WATCH|READ|SAY_AFTER|KILL_GRACE|DEADLINE_EXTRA|OBSERVED_EXTRA)_S"
)


def test_the_table_is_that_of_the_code() -> None:
    table = PAGE.read_text().partition(BEGIN)[2].partition(END)[0]
    assert table.strip().splitlines() == [*HEAD.splitlines(), *rows()], "make limits writes it"


def is_limit(module: str, name: str) -> bool:
    is_time = module.startswith(TIMED) and TIME.fullmatch(name) and not PAUSES.fullmatch(name)
    return bool(is_time or BY_NAME.fullmatch(name))


def test_each_limit_says_what_it_limits() -> None:
    bare = [f"{module}.{name}" for module, name, _, comment in constants() if is_limit(module, name) and not comment]
    assert [name for name in bare if not name.startswith(RANGES)] == [], "say behind it what is limited: #: a text"
