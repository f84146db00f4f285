"""Runs of a campaign, chosen by their names as pytest chooses tests: ``cyclic and not (1000hz or rr)``."""

import re
from collections.abc import Callable, Sequence

from rtfiles.errors import UsageError
from rtrun.plan.run import Run

_WORDS = re.compile(r"[()]|[^\s()]+")
_Chosen = Callable[[str], bool]


def select(runs: Sequence[Run], expression: str | None) -> tuple[Run, ...]:
    """The runs whose names match the expression; without one, all. It joins parts of names, in upper or lower case, by
    and, or, not and parentheses. Raises UsageError for an invalid expression, and if no run is left."""
    if expression is None:
        return tuple(runs)
    is_chosen = _parse(expression)
    if chosen := tuple(run for run in runs if is_chosen(run.name.lower())):
        return chosen
    raise UsageError(f"-k {expression}: is true of none of {len(runs)} runs, as {runs[0].name}")


def _parse(expression: str) -> _Chosen:
    words = _WORDS.findall(expression.lower())

    def wrong() -> UsageError:
        place = f"before {words[0]!r}" if words else "at the end"
        return UsageError(f"-k {expression}: a part of a run's name is missing {place}, as in 'cyclic and not fq1000'")

    def either() -> _Chosen:
        found = both()
        while words[:1] == ["or"]:
            del words[0]
            found = _joined(any, found, both())
        return found

    def both() -> _Chosen:
        found = operand()
        while words[:1] == ["and"]:
            del words[0]
            found = _joined(all, found, operand())
        return found

    def operand() -> _Chosen:
        if not words or words[0] in ("and", "or", ")"):
            raise wrong()
        word = words.pop(0)
        if word == "not":
            inner = operand()
            return lambda name: not inner(name)
        if word == "(":
            inner = either()
            if words[:1] != [")"]:
                raise UsageError(f"-k {expression}: ')' is missing")
            del words[0]
            return inner
        return lambda name: word in name

    found = either()
    if words:
        raise UsageError(f"-k {expression}: 'and' or 'or' is missing before {words[0]!r}")
    return found


def _joined(combine: Callable[[Sequence[bool]], bool], first: _Chosen, second: _Chosen) -> _Chosen:
    return lambda name: combine([first(name), second(name)])
