"""Explain why a symbol did not get its value, from the tree's Kconfig files, with kconfiglib.

The kernel's own ``conf`` decides whether an option holds; this only explains it. kconfiglib reads its settings from the
process environment and runs the compiler in the current folder, so `explain` runs this module as another process.
"""

import json
import re
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import kconfiglib

from rtfiles.errors import InfrastructureError
from rtgen.kconfig.tree import Architecture, Tree, environment
from rtgen.process import run

# Keywords of newer Kconfig versions that kconfiglib 14.1 does not know. The first has an older spelling. The second
# matters only for a config that is converted from an older kernel.
_NEWER = ((re.compile(r"^\s+modules\s*$"), "\toption modules\n"), (re.compile(r"^\s+transitional\s*$"), "\n"))


def explain(tree: Tree, architecture: Architecture, config: str, wanted: Mapping[str, str]) -> dict[str, str]:
    """A reason for each symbol whose value in a finished .config is not the wanted one.

    If a symbol has no reason here, kconfiglib could not read the tree or sees no difference.
    """
    if not wanted:
        return {}
    with tempfile.TemporaryDirectory(prefix="rtgen-explain-") as work:
        Path(work, ".config").write_text(config, encoding="utf-8")
        command = [sys.executable, "-m", __name__, json.dumps(dict(wanted))]
        try:
            output = run(command, folder=Path(work), environment=environment(tree, architecture))
        except InfrastructureError as error:
            last = str(error).splitlines()[-1].strip()
            return dict.fromkeys(wanted, f"no explanation, kconfiglib cannot read this tree: {last}")
    reasons: dict[str, str] = json.loads(output)
    return reasons


class _Kconfig(kconfiglib.Kconfig):  # type: ignore[misc]  # kconfiglib has no types; its reader is a method
    def _open(self, filename: str, mode: str) -> IO[str]:
        stream: IO[str] = super()._open(filename, mode)
        if Path(filename).name.startswith("Kconfig"):
            return _Rewritten(stream)  # type: ignore[return-value]
        return stream


class _Rewritten:
    """A Kconfig file with the newer keywords replaced by older ones."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self.close = stream.close

    def readline(self) -> str:
        line = self._stream.readline()
        for pattern, replacement in _NEWER:
            line = pattern.sub(replacement, line)
        return line


def reason(symbol: Any, value: str) -> str | None:
    """Why a kconfiglib symbol does not have this value in the loaded config; None if it has."""
    if symbol.str_value == value:
        return None
    if symbol.orig_type not in (kconfiglib.BOOL, kconfiglib.TRISTATE):
        return _reason_number(symbol, value)
    rank = {"n": 0, "m": 1, "y": 2}
    if value not in rank:
        return f"is y, m or n, it cannot be {value}"
    if rank[value] < symbol.tri_value:
        return _reason_on(symbol)
    if value == "m" and symbol.orig_type == kconfiglib.BOOL:
        return "cannot be a module"
    unmet = _terms_below(symbol.direct_dep, rank[value])
    if unmet:
        return "unmet dependency " + ", ".join(unmet)
    if symbol.choice is not None and symbol.choice.selection not in (None, symbol):
        chosen, prompt = symbol.choice.selection, symbol.choice.nodes[0].prompt
        return f"choice lost: {chosen.name} was chosen" + (f' in "{prompt[0]}"' if prompt else "")
    prompts = [node.prompt[1] for node in symbol.nodes if node.prompt]
    if not prompts:
        return f"has no prompt, only another option can select it{_selecting(symbol)}"
    hidden = [term for condition in prompts for term in _terms_below(condition, rank[value])]
    if hidden:
        return "its prompt is hidden, unmet dependency " + ", ".join(dict.fromkeys(hidden))
    return f"is not set, and its default is {symbol.str_value}{_selecting(symbol)}"


def _reason_number(symbol: Any, value: str) -> str:
    for low, high, condition in symbol.ranges:
        if kconfiglib.expr_value(condition):
            return f"{value} is out of its range {low.str_value} to {high.str_value}"
    unmet = _terms_below(symbol.direct_dep, 1)
    return "unmet dependency " + ", ".join(unmet) if unmet else "is not set, this is its default"


def _reason_on(symbol: Any) -> str:
    selecting = [term for term in _terms(symbol.rev_dep, kconfiglib.OR) if kconfiglib.expr_value(term)]
    if selecting:
        return "selected by " + ", ".join(_show(_terms(term, kconfiglib.AND)[0]) for term in selecting)
    if symbol.choice is not None and symbol.choice.selection is symbol:
        return "is selected in its choice, because no other option of the choice is set"
    if not any(node.prompt and kconfiglib.expr_value(node.prompt[1]) for node in symbol.nodes):
        return "has no prompt here, and its default is on"
    implying = [term for term in _terms(symbol.weak_rev_dep, kconfiglib.OR) if kconfiglib.expr_value(term)]
    if implying:
        return "is not turned off, implied by " + ", ".join(_show(_terms(term, kconfiglib.AND)[0]) for term in implying)
    return "is not turned off, and its default is on"


def _selecting(symbol: Any) -> str:
    names = [_show(_terms(term, kconfiglib.AND)[0]) for term in _terms(symbol.rev_dep, kconfiglib.OR)]
    names = [name for name in names if not name.startswith("n ")]
    return f"; it would be selected by {', '.join(names[:4])}" if names else ""


def _terms(expression: Any, operator: int) -> list[Any]:
    """The operands of a chain of one operator, as a flat list."""
    if isinstance(expression, tuple) and expression[0] == operator:
        return _terms(expression[1], operator) + _terms(expression[2], operator)
    return [expression]


def _terms_below(expression: Any, rank: int) -> list[str]:
    """The operands of a conjunction with a lower value than this (0: n, 1: m, 2: y)."""
    terms = _terms(expression, kconfiglib.AND)
    return [_show(term) for term in terms if kconfiglib.expr_value(term) < rank]


def _show(expression: Any) -> str:
    """An expression with the values of its symbols, such as ``EXPERT (is n)``."""
    text: str = kconfiglib.expr_str(expression, _plain_name)
    return text if isinstance(expression, tuple) else f"{text} (is {expression.str_value})"


def _plain_name(item: Any) -> str:
    return item.name if item.name else str(kconfiglib.standard_sc_expr_str(item))


def main(wanted: dict[str, str]) -> dict[str, str]:
    """The reasons for the config in this folder; the environment names the tree."""
    tree = _Kconfig("Kconfig", warn=False)
    tree.load_config(".config")
    reasons = {}
    for name, value in wanted.items():
        symbol = tree.syms.get(name)
        if symbol is None or not symbol.nodes:
            reasons[name] = "undefined symbol"
        elif text := reason(symbol, value):
            reasons[name] = text
    return reasons


if __name__ == "__main__":
    print(json.dumps(main(json.loads(sys.argv[1]))))
