"""Shared by HTML pages: those of the report, and those of a site about an archive."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment

_FOLDER = Path(__file__).parent


def templates(*folders: Path) -> "Environment":
    """The templates in these folders and of the report. Inserted text is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([*folders, _FOLDER]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["json"] = as_json
    environment.filters["percent"] = lambda place: f"{place:.2f}%"
    return environment


def script(*names: str) -> str:
    """Scripts of the report, one after another."""
    return "\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in names)


def as_json(value: Any) -> str:
    """JSON that cannot end the script element around it."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
