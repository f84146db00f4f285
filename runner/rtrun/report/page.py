"""The report as one HTML file that needs no network: it contains the styles, script, pictures and data."""

from typing import Any

from rtfiles.quantities import time
from rtrun.analysis.scale import Division, Scale
from rtrun.judgement.study import Study
from rtrun.report import layers
from rtrun.report.contents import Contents
from rtrun.report.how import explanations
from rtrun.report.html_pages import script, templates
from rtrun.report.plots import axes
from rtrun.report.plots.charts import plots
from rtrun.report.plots.drawing import drawn
from rtrun.report.plots.graph import drawn_topology
from rtrun.report.plots.stacks import stacked
from rtrun.report.quantities import times_ns
from rtrun.report.scenarios import Scenario

# The style class of an answer, which gives its colour, and its mark, for eyes and paper without colours.
_ANSWERS: dict[str, tuple[str, str]] = {
    "PROVEN": ("proven", "✓"),
    "PROVEN IF INDEPENDENT": ("more", "✓"),
    "NEEDS MORE": ("more", "?"),
    "REFUTED": ("refuted", "✗"),
    "not a real-time statement": ("none", "–"),
    "no deadline": ("none", "–"),
}
_OPENED = 3  # cards of failed scenarios that are open from the start
# In the overview, by the classes of their styles.
_PICTURED = {"min": "min", "median": "p50", "p99": "p99", "p9999": "p99.99", "max": "max"}


def html(study: Study, contents: Contents) -> str:
    """Return the page. Everything that came from a target is escaped."""
    environment = templates()
    environment.filters["time"] = time
    cards = [_card(study, scenario) for scenario in contents.scenarios]
    choices = {
        key: sorted({str(getattr(scenario, key)) for scenario in contents.scenarios})
        for key in ("suite", "policy", "condition", "answer")
    }
    return environment.get_template("page.html.j2").render(
        contents=contents,
        cards=cards,
        stacks={layers.TABLE: stacked(contents.stacks)},
        graphs=[drawn_topology(topology) for topology in contents.topologies],
        failed=sum(card["style"] == "refuted" for card in cards),
        opened=_OPENED,
        choices={key: values for key, values in choices.items() if len(values) > 1},
        overview=_overview(cards),
        how=explanations(),
        script=script("plots.js", "page.js"),
    )


def _card(study: Study, scenario: Scenario) -> dict[str, Any]:
    style, mark = _ANSWERS[scenario.answer]
    drawings = [drawn(plot) for plot in plots(scenario, probability=study.question.probability)]
    return {"scenario": scenario, "style": style, "mark": mark, "plots": drawings}


def _overview(cards: list[dict[str, Any]]) -> dict[str, Any] | None:
    """The picture of all scenarios on one logarithmic axis, in percentages of its width; None without scenarios."""
    measured = [card for card in cards if card["scenario"].figures.max_ns is not None]
    known = [value for card in measured for value in (*_pictured_ns(card).values(), _deadline_ns(card))]
    values_ns = [value for value in known if value is not None and value > 0]
    if not values_ns:
        return None
    axis = axes.times("", Scale(division=Division.LOG, low=min(values_ns) / 1.3, high=max(values_ns) * 1.3))

    def at(value_ns: float | None) -> float | None:
        return None if value_ns is None else 100 * float(axis.scale.at(max(value_ns, axis.scale.low)))

    rows = []
    for card in measured:
        pictured = _pictured_ns(card)
        rows.append(
            {
                "card": card,
                "at": {name: at(value) for name, value in pictured.items()},
                "below": pictured["min"] is not None and pictured["min"] < axis.scale.low,
                "deadline": at(_deadline_ns(card)),
                "tooltip": ", ".join(f"{name.replace('p9999', 'p99.99')} {time(ns)}" for name, ns in pictured.items()),
            }
        )
    deadlines = {_deadline_ns(card) for card in measured} - {None}
    limit_ns = deadlines.pop() if len(deadlines) == 1 else None
    limit = f"deadline {time(limit_ns)}" if limit_ns else "deadline" if deadlines else ""
    ticks = [(at(value), text) for value, text in axis.ticks]
    return {"rows": rows, "ticks": ticks, "limit": limit, "limit_at": at(limit_ns)}


def _pictured_ns(card: dict[str, Any]) -> dict[str, float | None]:
    times = times_ns(card["scenario"].figures)
    return {style: times[name] for style, name in _PICTURED.items()}


def _deadline_ns(card: dict[str, Any]) -> int | None:
    question = card["scenario"].group.question
    return question.deadline_ns if question else None
