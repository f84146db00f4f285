"""A build compared with its history: the cases of `rtrun gate --against`."""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import get_args

from rtrun.analysis.comparison.history import LEAST_BOOTS, Against, compare_figure, compare_misses, level_of_test
from rtrun.archive.adding import add_results, find_runs
from rtrun.archive.courses import Course, Figure, courses, figure_text
from rtrun.archive.notes import AcceptNote
from rtrun.archive.runs import RunRow, read_archive
from rtrun.archive.store import Store, make_archive
from rtrun.archive.tables import Origin
from rtrun.archive.trends import changed_facts
from rtrun.judgement.gate import Case, Gate, why_not_accepted
from rtrun.kinds.lateness import Measure
from rtrun.plan.suites import ALLOCATIONS
from rtrun.targets.inspection.platform import Platform

# A shift too small to matter, where no margin is given: a share of the reference, with a minimum, as in compare.
SHARE_OF_MARGIN, LEAST_MARGIN_NS = 0.05, 1000.0


def gate_against(
    results: Path,
    archive: Store,
    *,
    deadline_ns: int | None,
    measure: Measure | None = None,
    margin_ns: float | None,
    false_alarms: float,
    platform: Platform,
) -> Gate:
    """Fail the cases that are worse than their history by more than the margin, or cannot be compared with it.

    If only one boot is worse, the build is PERHAPS WORSE, which does not pass: a second boot decides. `false_alarms`
    bounds the chance that a year of daily gates, of builds that are as good as their history, has any WORSE. The runs
    of `results` themselves are not part of the history.
    """
    with tempfile.TemporaryDirectory() as folder:
        own = make_archive(folder)
        added = add_results(find_runs(results), own, Origin(), samples=False, on_added=lambda _count, _total: None)
        builds: list[Course] = []
        without_course: list[tuple[str, str]] = []
        if added.added:
            build_archive = read_archive(own)
            builds = courses(build_archive, deadline_ns=deadline_ns, measure=measure)
            without_course = _without_course(build_archive.runs, builds, measure)
    histories = {
        course.identity: course for course in courses(read_archive(archive), deadline_ns=deadline_ns, measure=measure)
    }
    reasons = [text.split(": ", 1) for text in (*added.refused, *added.notes)]
    cases = [
        Case(about=name, answer="NOT ANALYSED", text=reason, passed=False)
        for name, reason in (*reasons, *without_course)
    ]
    for build in builds:
        known = histories.get(build.identity)
        history = _without(known, build)
        accepted = known.accepted if known else None
        cases.append(_case(build, history, accepted, margin_ns, false_alarms / len(builds), platform))
    order = ("NOT ANALYSED", "WORSE", "PERHAPS WORSE", "NO HISTORY", "NOT WORSE")
    return Gate(cases=tuple(sorted(cases, key=lambda case: order.index(case.answer))))


def _without_course(runs: Sequence[RunRow], builds: Sequence[Course], measure: Measure | None) -> list[tuple[str, str]]:
    """The runs that are in no course, and why; runs that count allocations are left out, as no course includes them."""
    known = {key for build in builds for run in build.runs for key in run.point.run_keys}
    reasons = []
    for row in sorted(runs, key=lambda row: row.run):
        if row.status != "ok":
            reasons.append((row.run, ": ".join(filter(None, (row.status, row.reason)))))
        elif row.start_utc is None:
            reasons.append((row.run, "it has no start time, so it has no place in a history"))
        elif row.run_key not in known and not json.loads(row.parameters).get(ALLOCATIONS):
            reasons.append((row.run, f"it has no {measure or 'values'}"))
    return reasons


def _without(history: Course | None, build: Course) -> Course | None:
    """The history without the runs of the build and those before its level was accepted; None if none are left."""
    if history is None:
        return None
    own = {run.point.run_keys for run in build.runs}
    begin = history.accepted.begin if history.accepted else datetime.min
    others = tuple(
        run for run in history.runs if run.point.run_keys not in own and (run.point.start_utc or begin) >= begin
    )
    return replace(history, runs=others) if others else None


def _case(
    build: Course,
    history: Course | None,
    accepted: AcceptNote | None,
    margin_ns: float | None,
    false_alarms: float,
    platform: Platform,
) -> Case:
    since = f" since its level was accepted from {accepted.begin:%Y-%m-%d} on: {accepted.words}" if accepted else ""
    boots = 0 if history is None else len(history.boots())
    n = sum(run.point.n for run in build.runs)
    known = [run.point.misses for run in build.runs if run.point.misses is not None]
    misses = sum(known) if len(known) == len(build.runs) else None
    worst_ns = max((run.point.max_ns for run in build.runs if run.point.max_ns is not None), default=None)
    case = partial(Case, about=build.label, n=n, misses=misses, worst_ns=worst_ns)
    shared = [
        (figure, before, now)
        for figure in get_args(Figure)
        if history and (before := history.knowing(figure)) and (now := build.knowing(figure))
        if len(before.boots()) >= LEAST_BOOTS
    ]
    if history is None or not shared:
        text = f"{boots} boots of it are in the archive, {LEAST_BOOTS} are needed{since}"
        if boots >= LEAST_BOOTS:
            text = "too few measurements a run for any figure"
        return case(answer="NO HISTORY", text=text, passed=False)
    level = level_of_test(false_alarms, len(shared))
    compared = [(figure, _compare(figure, now, before, margin_ns, level)) for figure, before, now in shared]
    exceeds = [(figure, against) for figure, against in compared if against.exceeds]
    worse = [(figure, against) for figure, against in exceeds if against.worse]
    text = "; ".join(_words(figure, against) for figure, against in worse or exceeds or compared)
    if exceeds and not worse:
        text = f"{text}; {_advice(len(build.boots()))}"
    if since:
        text = f"{text}; history{since}"
    passed = not exceeds
    if passed and (why := why_not_accepted(Platform(build.platform), platform)):
        text, passed = f"{text}; {why}", False
    return case(
        answer="WORSE" if worse else "PERHAPS WORSE" if exceeds else "NOT WORSE",
        text=text,
        passed=passed,
        reason="" if passed else None,
        changed=tuple(changed_facts(history.boots(), build.boots())) if exceeds else (),
    )


def _advice(boots: int) -> str:
    bad, more = ("one bad boot", "a second") if boots == 1 else (f"the worst of its {boots} boots alone", "another")
    return f"this may be {bad}: measure {more} boot, and put its runs into the same folder"


def _compare(figure: Figure, build: Course, history: Course, margin_ns: float | None, level: float) -> Against:
    if figure == "P(miss)":
        return compare_misses(history.misses(), build.misses(), level=level)
    return compare_figure(
        history.values(figure),
        build.values(figure),
        level=level,
        margin=margin_ns,
        share=SHARE_OF_MARGIN,
        least=LEAST_MARGIN_NS,
    )


def _words(figure: Figure, against: Against) -> str:
    values = (against.value, against.reference, against.limit, against.noticed)
    texts = [figure_text(figure, value) for value in values]
    return (
        f"{figure} {texts[0]}, best level of {against.boots} boots {texts[1]}, limit {texts[2]}, "
        f"noticed nine times in ten from {texts[3]} on"
    )
