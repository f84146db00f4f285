"""A static site about an archive: all scenarios, all boards, a page for each course, and figures for Grafana.

Pages of the report and of the site share styles and plotting code.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rtfiles import atomic
from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.archive import NO_DEADLINE
from rtrun.archive.alarms import BOARDS_PAGE, REASON_MAX
from rtrun.archive.boards import BoardRow, board_rows, columns_of
from rtrun.archive.courses import Course
from rtrun.archive.fleet import BoardHealth, ScenarioHealth, counts_in_words, reason_of
from rtrun.archive.metrics import grafana_dashboard, open_metrics
from rtrun.archive.pictures import course_plots
from rtrun.archive.queries import SHOWN
from rtrun.archive.states import HISTORY, JUDGED_FROM, TEXTS, CourseState, state_of
from rtrun.archive.trends import Trend, as_text, shown_time
from rtrun.report.html_pages import script, templates
from rtrun.report.plots.drawing import drawn
from rtrun.report.terminal import BANNERS
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.labgrid.health import in_words

_MARKS = {"WORSE": "✗ WORSE", "better": "✓ BETTER", "accepted": "✓ ACCEPTED"}


def write_site(
    folder: Path,
    archive: str,
    courses: Sequence[Course],
    trends: Sequence[Trend],
    boards: Sequence[BoardHealth],
    *,
    farm: str,
    deadline_ns: int | None,
    confidence: float,
) -> list[Path]:
    """Write every file of the site into an existing folder; returns them, the front page first. Raises OSError.

    `farm` states what is not known about boards because no farm reported it, empty if a farm did.
    """
    by_course: dict[tuple[str, str, str, str, str], list[Trend]] = {course.identity: [] for course in courses}
    for trend in trends:
        by_course[trend.course.identity].append(trend)
    cards = [_card(course, by_course[course.identity], confidence) for course in courses]
    cards.sort(key=lambda card: (card["state"].style != "refuted", card["label"]))
    banners = {card["banner"] for card in cards}
    words = {
        # Readers of the pages need not know where the archive is stored.
        "archive": archive.rstrip("/").rpartition("/")[2],
        "deadline": deadline_ns and time(deadline_ns),
        "ask": f"{NO_DEADLINE[0].upper()}{NO_DEADLINE[1:]}.",
        "percentiles": [f"p{percent:g}" for percent in SHOWN],
        "banner": banners.pop() if len(banners) == 1 else "",
        "banners": sorted(filter(None, banners)),
        "answer": _answer([card["state"] for card in cards]),
        "boards": counts_in_words(boards),
        "are_ill": any(board.is_ill for board in boards),
        "history": f"{HISTORY[0].upper()}{HISTORY[1:]}.",
        "written": shown_time(datetime.now(UTC)),
    }
    environment = templates(Path(__file__).parent)
    front, page, overview = (environment.get_template(f"{name}.html.j2") for name in ("site", "course", "boards"))
    rows = board_rows([(card["course"], card["state"]) for card in cards])
    worse = {row.board for row in rows if any(cell.state == "WORSE" for cell in row.cells.values())}
    health = [_health(board) for board in boards]
    failed = [_failed_row(board, scenario) for board in boards for scenario in board.failed]
    pages = {
        "index.html": front.render(cards=cards, **words),
        BOARDS_PAGE: overview.render(
            rows=rows,
            columns=columns_of(rows),
            worse=worse,
            judged=_judged(rows, worse),
            health=health,
            failed=failed,
            farm=farm,
            **words,
        ),
    }
    drawing = script("plots.js")
    for card in cards:
        plots = [drawn(plot) for plot in course_plots(card["course"], card["trends"], deadline_ns=deadline_ns)]
        pages[card["page"]] = page.render(card=card, plots=plots, script=drawing, **words)
    pages["metrics.txt"] = open_metrics(courses, boards, deadline_ns=deadline_ns)
    pages["grafana-dashboard.json"] = grafana_dashboard()
    for name, text in pages.items():
        atomic.write_bytes(folder / name, text.encode("utf-8", "replace"))
    return [folder / name for name in pages]


def _health(board: BoardHealth) -> dict[str, Any]:
    """A board with everything to report about it, each state with the class of its style."""
    texts = {
        "QUARANTINE": ("refuted", f"✗ QUARANTINE: {in_words(board.quarantine or '')}"),
        "OFFLINE": ("refuted", f"✗ OFFLINE: {board.offline}"),
        "FAILED": ("refuted", f"✗ FAILED: {len(board.failed)} of {counted(len(board.scenarios), 'scenario')}"),
        "NEW": ("more", f"? NEW: {counted(board.boots, 'boot')} of {JUDGED_FROM}"),
        "MEASURING": ("proven", f"▶ MEASURING: {board.holder} holds it"),
        "IDLE": ("proven", "✓ IDLE"),
        "OK": ("proven", "✓ no run failed"),
    }
    states = [texts[word] for word in board.states]
    if board.failed_check:
        states.append(("more", f"? failed its last check: {in_words(board.failed_check)}"))
    last = board.last_failed
    return {
        "board": board.board,
        "states": states,
        "what": ", ".join(board.description),
        "command_line": board.command_line,
        "last_seen": shown_time(board.last_seen) if board.last_seen else "never",
        "last_run": shown_time(board.last_run) if board.rows else "never",
        "last_failed": last and f"{shown_time(last.start_utc)} {last.scenario}: {reason_of(last)[:REASON_MAX]}",
    }


def _failed_row(board: BoardHealth, scenario: ScenarioHealth) -> dict[str, str]:
    """The cells of a scenario whose last run failed, by the heading of their column."""
    first, last = scenario.failures[0], scenario.last
    return {
        "board": board.board,
        "scenario": last.scenario,
        "why": scenario.reason[:REASON_MAX],
        "last run, UTC": shown_time(last.start_utc),
        "in a row": str(len(scenario.failures)),
        "since, UTC": shown_time(first.start_utc),
        "run": last.run,
    }


def _card(course: Course, trends: Sequence[Trend], confidence: float) -> dict[str, Any]:
    misses = [run.point.misses for run in course.runs]
    rows = [
        (
            shown_time(run.point.start_utc),
            run.point.kernel or "unknown",
            run.facts.get("commit", "unknown"),
            grouped(run.point.n),
            *map(time, run.point.times_ns.values()),
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


def _judged(rows: Sequence[BoardRow], worse: Collection[str]) -> str:
    """How many boards got worse, and how many cannot be judged yet, in one sentence."""
    known = {row.board for row in rows}
    new = known - {row.board for row in rows for cell in row.cells.values() if cell.state not in ("", "NEW")}
    sentences = []
    if worse:
        sentences.append(f"✗ Something got worse on {len(worse)} of {counted(len(known), 'board')}")
    elif len(new) < len(known):
        sentences.append("Nothing got worse")
    if new:
        sentences.append(f"{len(new)} of {counted(len(known), 'board')} too new to judge")
    return "; ".join(sentences) or "Nothing is known yet"


def _answer(states: Sequence[CourseState]) -> str:
    """What is known about all courses, in one sentence."""
    counts = Counter(state.word for state in states)
    texts = [f"{counts[word]} {text}" for word, text in TEXTS.items() if counts[word]] or ["nothing is known yet"]
    return f"Of {counted(len(states), 'scenario')} {', '.join(texts)}."
