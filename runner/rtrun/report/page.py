"""The report as one HTML file that needs no network: styles, script, plots, plotly and the data are in it."""

from typing import Any

from rtfiles.quantities import time_us
from rtrun.judgement.study import Study
from rtrun.report import layers
from rtrun.report.contents import Contents
from rtrun.report.html_pages import as_json, figures, script, templates
from rtrun.report.plots.charts import plots
from rtrun.report.plots.stacks import stacked
from rtrun.report.scenarios import Scenario

# The class of an answer in the styles, which give it its colour, and its mark, for eyes and paper without colours.
_ANSWERS: dict[str, tuple[str, str]] = {
    "PROVEN": ("proven", "✓"),
    "PROVEN IF INDEPENDENT": ("more", "✓"),
    "NEEDS MORE": ("more", "?"),
    "REFUTED": ("refuted", "✗"),
    "not a real-time statement": ("none", "–"),
    "no deadline": ("none", "–"),
}
_OPENED = 3  # cards of failed scenarios that are open from the start
_PICTURED = {"median": 50.0, "p99": 99.0, "p99.99": 99.99}


def html(study: Study, contents: Contents) -> str:
    """Return the page. Everything that came from a target is escaped."""
    from plotly.offline import get_plotlyjs

    environment = templates()
    environment.filters["time_us"] = time_us
    cards = [_card(study, scenario) for scenario in contents.scenarios]
    choices = {
        key: sorted({str(getattr(scenario, key)) for scenario in contents.scenarios})
        for key in ("suite", "policy", "condition", "answer")
    }
    overview = {
        "rows": [_row(scenario) for scenario in contents.scenarios if scenario.figures.max_ns is not None],
    }
    return environment.get_template("page.html.j2").render(
        contents=contents,
        cards=cards,
        pictures={layers.TABLE: figures(stacked(contents.stacks))},
        failed=sum(card["style"] == "refuted" for card in cards),
        opened=_OPENED,
        choices={key: values for key, values in choices.items() if len(values) > 1},
        overview=as_json(overview),
        plotly=get_plotlyjs(),
        script=script("plots.js", "page.js"),
    )


def _card(study: Study, scenario: Scenario) -> dict[str, Any]:
    style, mark = _ANSWERS[scenario.answer]
    drawn = plots(scenario, probability=study.question.probability)
    return {
        "scenario": scenario,
        "style": style,
        "mark": mark,
        "plots": figures(drawn),
    }


def _row(scenario: Scenario) -> dict[str, Any]:
    """A row of the picture of all scenarios; times in us."""
    figures = scenario.figures
    style, mark = _ANSWERS[scenario.answer]
    values_ns = [figures.min_ns, *(figures.percentiles_ns.get(p) for p in _PICTURED.values()), figures.max_ns]
    values_us = [None if value_ns is None else value_ns / 1000 for value_ns in values_ns]
    return {
        "id": scenario.id,
        "deadline_us": scenario.group.question and scenario.group.question.deadline_ns / 1000,
        "label": scenario.label,
        "answer": scenario.answer,
        "style": style,
        "mark": mark,
        "us": dict(zip(("min", *_PICTURED, "max"), values_us, strict=True)),
    }
