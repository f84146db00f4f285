"""YAML at the edge: whatever a file holds, what is wrong with it is a UsageError with file and line."""

from pathlib import Path
from typing import Literal

import pytest
import yaml
from pydantic import Field

from rtfiles import config
from rtfiles.config import Config, load, read_yaml
from rtfiles.errors import UsageError


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2024-02-30\n", ":2: no valid timestamp: day is out of range for month; a text is to be in quotes"),
        ("a: !!int x\n", ":1: no valid int: invalid literal for int() with base 10: 'x'"),
        ("a: !!bool x\n", ":1: no valid bool: "),
        ("a: !!timestamp x\n", ":1: no valid timestamp: "),
        (f"a: {'1' * 5000}\n", ":1: no valid int: a number has at most 40 characters"),
        ("[" * 5000, ": nested too deeply"),
        (f"a: {'1:' * 500_000}1\n", ":1: no valid int: a number has at most 40 characters"),
        ("#" * (1 << 20) + "\n", ": larger than 1048576 bytes"),
        ("a: &a [*a]\n", ":1: an alias within what it names"),
        ('a: 1\nb: "\\ud800"\n', ":2: a text with half of a character (a lone surrogate)"),
        ('"\\udfff": 1\n', ":1: a text with half of a character (a lone surrogate)"),
        (
            "a0: &a0 [x, x]\n" + "".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(30)),
            ":17: its aliases stand for more than 200000 values",
        ),
        (
            "a0: &a0 {x: 1}\n" + "".join(f"a{n + 1}: &a{n + 1} {{<<: [*a{n}, *a{n}]}}\n" for n in range(30)),
            ":17: its aliases stand for more than 200000 values",
        ),
    ],
)
def test_what_python_cannot_take(tmp_path, text, message):
    file = tmp_path / "a.yml"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        read_yaml(file)
    assert str(caught.value).startswith(f"{file}{message}")


class Example(Config):
    schema_: Literal[1] = Field(alias="schema")
    name: str


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a mapping with the keys schema, name"),
        ("[1]", "expected a mapping with the keys schema, name"),
        ("schema_: 1", "unknown key 'schema_', did you mean 'schema'? allowed: schema, name"),
    ],
)
def test_keys_are_named_as_they_stand_in_a_file(tmp_path, text, message):
    file = tmp_path / "a.yml"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        load(file, Example)
    assert str(caught.value) == f"{file}{':1' if text.startswith('schema') else ''}: {message}"


def test_what_an_error_shows_is_limited(tmp_path):
    file = tmp_path / "a.yml"
    file.write_text(f"schema: {'x' * 5000}\nname: 5\n" + "".join(f"{'k' * 1000}{n}: 1\n" for n in range(900)))
    with pytest.raises(UsageError) as caught:
        load(file, Example)
    assert len(str(caught.value)) < 4000


def test_own_files_are_read_as_those_of_others_are():
    """Those are read by a parser of C, and keys that are given twice are not looked for."""
    top = Path(__file__).parents[2]
    files = [path for folder in ("runner/rtrun", "tools/rtgen") for path in sorted((top / folder).rglob("*.yml"))]
    assert len(files) > 40
    assert [path for path in files if read_yaml(path) != yaml.load(path.read_text(), config._OWN_LOADER)] == []
