"""The programs in suites.yml as a committed C++ source, so that they build without Python."""

import json
from pathlib import PurePosixPath
from typing import Any

from rtfiles.config import read_yaml
from rtgen.checkout import shipped
from rtgen.layer.render import SOURCES, Tree, marked, templates

PATH = SOURCES / "rt_tests_support/src/programs.cpp"


def render_programs() -> Tree:
    """The one file, by its path in the checkout."""
    environment = templates()
    environment.filters |= {"cpp": _cpp, "kind": _kind}
    data = read_yaml(shipped(str(SOURCES)) / "suites.yml")
    text = environment.get_template("recipes-tests/programs.cpp.j2").render(data)
    return {PATH: marked(str(PATH), text, str(PurePosixPath(SOURCES, "suites.yml")))}


def _cpp(value: Any) -> str:
    """A C++ literal: a text (written like JSON), a list of texts, or nullptr."""
    if isinstance(value, list):
        return "{" + ", ".join(map(_cpp, value)) + "}"
    return "nullptr" if value is None else json.dumps(str(value))


def _kind(option: dict[str, Any]) -> str:
    """The enumerator of rt_tests::Kind."""
    if option["type"] == "string":
        return "cpus" if "pattern" in option else "text"
    return {"int": "integer", "choice": "choice"}[option["type"]]
