"""The limits in docs/security.md are those of the code, and the code says of each whether it is one."""

import re

from docs_table import END
from limits import BEGIN, HEAD, PAGE, constants, rows

# A constant of such a name says what it limits, or behind a plain # what else it is. Ranges of numbers have a module.
BY_NAME = re.compile(r"_?MAX_\w+|\w+_MAX|\w*LIMIT_BYTES")
RANGES = "rtrun.kinds.limits"


def test_the_table_is_that_of_the_code() -> None:
    table = PAGE.read_text().partition(BEGIN)[2].partition(END)[0]
    assert table.strip().splitlines() == [*HEAD.splitlines(), *rows()], "make limits writes it"


def test_each_limit_says_what_it_limits() -> None:
    bare = [f"{module}.{name}" for module, name, _, comment in constants() if BY_NAME.fullmatch(name) and not comment]
    assert [name for name in bare if not name.startswith(RANGES)] == [], "say behind it what is limited: #: a text"
