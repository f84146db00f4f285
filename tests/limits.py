"""Writes the limits of docs/security.md from the code: of each constant that has what it limits behind `#:`."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

from docs_table import write_rows
from rtfiles.quantities import grouped
from rtrun.plan.quantities import size_text

TOP = Path(__file__).parents[1]
PAGE = TOP / "docs/security.md"
BEGIN = "<!-- make limits writes from here -->"
HEAD = "| what is limited | limit | constant |\n|---|---|---|"
_CONSTANT = re.compile(r"^(_?[A-Z][A-Z0-9_]*)(?:: [^=\n]+)? = [^#\n]*(?:# ?(:?) *(.*))?$", re.MULTILINE)


def constants() -> Iterator[tuple[str, str, bool, str]]:
    """Module and name of each constant, whether it is a limit, and its comment; packages and modules in order."""
    for package in ("tools/rtfiles", "tools/rtgen", "runner/rtrun"):
        for path in sorted((TOP / package).rglob("*.py")):
            module = ".".join(path.relative_to((TOP / package).parent).with_suffix("").parts)
            for name, mark, comment in _CONSTANT.findall(path.read_text()):
                yield module, name, bool(mark), comment


def _limit(name: str, value: float) -> str:
    """A limit with the unit that its name has."""
    if name.endswith("BYTES_PER_S"):
        return f"{size_text(int(value))}/s"
    if "BYTES" in name:
        return size_text(int(value))
    return f"{grouped(value)} s" if name.endswith("_S") and "_PER_" not in name else grouped(value)


def rows() -> list[str]:
    """The rows of the table."""
    return [
        f"| {text} | {_limit(name, getattr(importlib.import_module(module), name))} | `{module}.{name}` |"
        for module, name, is_limit, text in constants()
        if is_limit
    ]


if __name__ == "__main__":
    write_rows(PAGE, BEGIN, HEAD, rows())
