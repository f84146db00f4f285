"""What is wrong with a value, in the words of this project, so that a person can correct it."""

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

# Limits for quoting wrong input, which somebody else may have written.
SHOWN_WORDS = 20
SHOWN_CHARACTERS = 80

# By pydantic's error type; the braces name its limits. Other errors are reported in pydantic's words.
_TAKES = {
    "bool_type": "true or false",
    "dict_type": "a mapping of keys to values",
    "enum": "{expected}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number from {ge} up",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number of 64 bits",
    "int_type": "a whole number",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number up to {le}",
    "list_type": "a list",
    "literal_error": "{expected}",
    "model_type": "a mapping of keys to values",
    "none_required": "nothing",
    "string_too_long": "a text of {max_length} or fewer characters",
    "string_too_short": "a text of {min_length} or more characters",
    "string_type": "a text",
    "too_long": "{max_length} or fewer entries",
    "too_short": "{min_length} or more entries",
    "tuple_type": "a list",
}


def unknown(noun: str, *words: object, known: Iterable[str], label: str = "known") -> str:
    """`unknown suite 'cyclic_timer_test', did you mean 'cyclic_timer_tests'? known: …`."""
    known = tuple(known)
    texts = [str(word)[:SHOWN_CHARACTERS] for word in words[:SHOWN_WORDS]]
    return f"unknown {noun} {', '.join(map(repr, texts))},{did_you_mean(texts, known)} {label}: {', '.join(known)}"


def did_you_mean(words: Iterable[str], known: Sequence[str]) -> str:
    """The known words that may have been meant, as ` did you mean 'a'?`; empty if none is similar."""
    import difflib

    close = {name: None for word in words for name in difflib.get_close_matches(word, known, n=1, cutoff=0.7)}
    return f" did you mean {' and '.join(map(repr, close))}?" if close else ""


def mistake(errors: Sequence["ErrorDetails"]) -> str:
    """What is wrong with one value; several errors belong to the alternatives of a union."""
    (first, *_), value = errors, errors[0]["input"]
    if first["type"] == "missing":
        return "is missing"
    if first["type"] in ("value_error", "unknown_key"):
        return first["msg"].removeprefix("Value error, ")
    got = f", got {repr(value)[:SHOWN_CHARACTERS]}" if isinstance(value, str | int | float | bool) else ""
    if any(error["type"] not in _TAKES for error in errors):
        return f"{first['msg']}{got}"
    takes = " or ".join(dict.fromkeys(_TAKES[error["type"]].format_map(error.get("ctx", {})) for error in errors))
    return f"takes {takes}{got}{_choice(first)}"


def _choice(error: "ErrorDetails") -> str:
    if error["type"] not in ("literal_error", "enum") or not isinstance(error["input"], str):
        return ""
    known = re.findall(r"'([^']+)'", error.get("ctx", {}).get("expected", ""))
    hint = did_you_mean([error["input"][:SHOWN_CHARACTERS]], known)
    return f",{hint}" if hint else ""
