"""A site of static pages about an archive: all scenarios, all boards, a page for each course, and figures for Grafana.

Pages of the report and of the site share styles and plotting code.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rtfiles import atomic
from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.archive.boards import board_rows, columns_of
from rtrun.archive.courses import Course
from rtrun.archive.metrics import grafana_dashboard, open_metrics
from rtrun.archive.pictures import course_plots
from rtrun.archive.states import SAID, CourseState, state_of
from rtrun.archive.trends import Trend, as_text
from rtrun.report.html_pages import drawings, script, templates
from rtrun.report.terminal import BANNERS
from rtrun.targets.inspection.platform import Platform

_SHOWN = (50.0, 99.0, 99.9, 99.99)
_MARKS = {"WORSE": "✗ WORSE", "better": "✓ BETTER", "accepted": "✓ ACCEPTED"}


def write_site(
    folder: Path,
    archive: str,
    courses: Sequence[Course],
    trends: Sequence[Trend],
    *,
    deadline_ns: int,
    confidence: float,
) -> list[Path]:
    """Write every file of the site into a folder that exists; returns them, the front page first. Raises OSError."""
    by_course: dict[tuple[str, str, str, str, str], list[Trend]] = {course.identity: [] for course in courses}
    for trend in trends:
        by_course[trend.course.identity].append(trend)
    cards = [_card(course, by_course[course.identity], confidence) for course in courses]
    cards.sort(key=lambda card: (card["state"].style != "refuted", card["label"]))
    banners = {card["banner"] for card in cards}
    words = {
        # Readers of the pages need not know where the archive lies.
        "archive": archive.rstrip("/").rpartition("/")[2],
        "deadline": time(deadline_ns),
        "percentiles": [f"p{p:g}" for p in _SHOWN],
        "banner": banners.pop() if len(banners) == 1 else "",
        "banners": sorted(filter(None, banners)),
        "answer": _answer([card["state"] for card in cards]),
    }
    environment = templates(Path(__file__).parent)
    front, page, boards = (environment.get_template(f"{name}.html.j2") for name in ("site", "course", "boards"))
    rows = board_rows([(card["course"], card["state"]) for card in cards])
    worse = sorted({row.board for row in rows if any(cell.state == "WORSE" for cell in row.cells.values())})
    pages = {
        "index.html": front.render(cards=cards, **words),
        "boards.html": boards.render(rows=rows, columns=columns_of(rows), worse=worse, **words),
    }
    drawing = script("plots.js")
    for card in cards:
        plots = drawings(course_plots(card["course"], card["trends"], deadline_ns=deadline_ns))
        pages[card["page"]] = page.render(card=card, plots=plots, script=drawing, **words)
    pages["metrics.txt"] = open_metrics(courses, deadline_ns=deadline_ns)
    pages["grafana-dashboard.json"] = grafana_dashboard()
    for name, text in pages.items():
        atomic.write_bytes(folder / name, text.encode("utf-8", "replace"))
    return [folder / name for name in pages]


def _card(course: Course, trends: Sequence[Trend], confidence: float) -> dict[str, Any]:
    misses = [run.point.misses for run in course.runs]
    rows = [
        (
            f"{run.point.start_utc:%Y-%m-%d %H:%M}",
            run.point.kernel or "unknown",
            run.facts.get("commit", "unknown"),
            grouped(run.point.n),
            *(time(run.point.percentiles_ns[p]) for p in _SHOWN),
            time(run.point.max_ns),
            "unknown" if run.point.misses is None else str(run.point.misses),
        )
        for run in reversed(course.runs)
    ]
    return {
        "course": course,
        "trends": trends,
        "label": course.label,
        "page": course.page,
        "state": state_of(course, trends),
        "banner": BANNERS.get(Platform(course.platform), ""),
        "row": rows[0],
        "rows": rows,
        "since": f"{course.runs[0].point.start_utc:%Y-%m-%d}",
        "boots": len(course.boots()),
        "measured": f"{counted(len(rows), 'run')} on {counted(len(course.boots()), 'boot')}",
        "n": grouped(sum(run.point.n for run in course.runs)),
        "misses": "not known how many" if None in misses else sum(filter(None, misses)),
        "changes": [
            ("refuted" if trend.is_worse else "proven", _MARKS[trend.word], as_text(trend, confidence=confidence))
            for trend in sorted(trends, key=lambda trend: trend.change.index, reverse=True)
        ],
    }


def _answer(states: Sequence[CourseState]) -> str:
    """What is known of all courses, in one sentence."""
    counts = Counter(state.word for state in states)
    said = [f"{counts[word]} {text}" for word, text in SAID.items() if counts[word]]
    return f"Of {counted(len(states), 'scenario')} {', '.join(said)}."
