"""What pages of HTML share: the report's, and those of a site about an archive."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.report.plots.charts import Plot

if TYPE_CHECKING:
    from jinja2 import Environment

_FOLDER = Path(__file__).parent


def templates(*folders: Path) -> "Environment":
    """The templates of these folders and of the report. What is filled in is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader([*folders, _FOLDER]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def script(*names: str) -> str:
    """Scripts of the report, one after the other."""
    return "\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in names)


def figures(plots: Iterable[Plot]) -> list[dict[str, str]]:
    """Caption and figure of each plot, as a template takes them."""
    return [{"caption": plot.caption, "json": as_json({"data": plot.data, "layout": plot.layout})} for plot in plots]


def as_json(value: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
