"""The report as one HTML file that needs no network: styles, script, plots and data are in it."""

from pathlib import Path

from rtrun.report.document import Document
from rtrun.report.plots.charts import long_term, long_term_still, plots
from rtrun.report.study import Study

_FOLDER = Path(__file__).parent
# What a reader looks up stands after the plots.
_LAST = ("published", "environment", "reproduce")


def html(study: Study, document: Document) -> str:
    """Return the page. Everything that came from a target is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined, trim_blocks=False
    )
    drawn = [(group.label, plots(group, study.deadline_ns)) for group in study.groups]
    turned = []
    for suite in dict.fromkeys(group.suite for group in study.groups):
        data = long_term(study, suite)
        if data is not None:
            turned.append({"suite": suite, "data": data, "still": long_term_still(data, f"Long-term plot of {suite}")})
    return environment.get_template("page.html.j2").render(
        title=document.title,
        banner=document.banner,
        summary=document.summary,
        question=document.question,
        lines=document.lines,
        tables=document.tables,
        left_out=document.left_out,
        last=_LAST,
        plots=[(label, figures) for label, figures in drawn if figures],
        long_term=turned,
        script=(_FOLDER / "page.js").read_text(encoding="utf-8"),
    )
