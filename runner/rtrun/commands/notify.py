"""rtrun notify: report once what got worse or failed, and which boards are offline, ill or new."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._archive import add_archive, add_deadline, read_whole
from rtrun.commands._arguments import add_json
from rtrun.commands._question import add_confidence

if TYPE_CHECKING:
    from rtrun.archive.alarms import Alarm
    from rtrun.archive.courses import Course
    from rtrun.archive.runs import Archive

HELP = "tell a command, a web hook or by mail, once each, of what got worse or failed, and of boards away, ill or new"
EXAMPLES = (
    "rtrun notify lab.yml archive",
    "rtrun notify lab.yml archive --results results/brakes",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("receivers", type=Path, metavar="RECEIVERS.yml", help="who is told, and how")
    add_archive(parser)
    parser.add_argument(
        "--results",
        type=Path,
        metavar="RESULTS",
        help="tell of these runs alone, where gate --against says that they are WORSE than the archive",
    )
    add_deadline(parser)
    add_confidence(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Notify every receiver of what it has not received yet.

    Raises InfrastructureError for the receivers that did not accept it, after all were tried.
    """
    from datetime import UTC, datetime

    from rtfiles.config import load
    from rtfiles.errors import InfrastructureError, UsageError
    from rtfiles.output import counted, print_json, print_line
    from rtrun.archive.extra import check_extra

    check_extra()
    from rtrun.archive.alarms import board_alarms
    from rtrun.archive.courses import courses
    from rtrun.archive.fleet import ask_farm, boards_of
    from rtrun.archive.notifications import ALARMS_MAX, add_told, check_memory, not_told, read_told
    from rtrun.archive.receivers import Receivers, tell

    config = load(args.receivers, Receivers)
    names = [receiver.name for receiver in config.receivers]
    if len({*names}) < len(names):
        raise UsageError(f"{args.receivers}: receivers: two of one name: what each was told is kept by its name")
    archive = read_whole(args)
    alarms = _worse(args, archive, courses(archive, deadline_ns=args.deadline, measure=args.measure))
    failures = []
    if not args.results:
        try:
            farm = ask_farm(config.coordinator) if config.coordinator else None
        except InfrastructureError as error:  # what is known without it is still sent
            farm = None
            failures.append(str(error))
        alarms += board_alarms(boards_of(archive.runs, farm), archive.notes)
    sent: list[dict[str, str]] = []
    messages = read_told(archive.store)
    check_memory(archive.store, messages, len(names))
    for receiver in config.receivers:
        new = not_told(receiver.name, alarms, messages)[:ALARMS_MAX]
        if not new:
            continue
        try:
            tell(receiver, new, config.site)
            add_told(archive.store, receiver.name, new, datetime.now(UTC).replace(tzinfo=None))
        except (InfrastructureError, UsageError) as error:
            failures.append(str(error))
            continue
        sent += [{"receiver": receiver.name, "about": alarm.about, "size": alarm.size} for alarm in new]
        if not args.json:
            for alarm in new:
                print_line(f"{receiver.name} was told: {alarm.about}: {alarm.size}")
    known = [{"about": alarm.about, "reason": alarm.known} for alarm in alarms if alarm.known]
    wrong = sum(alarm.kind != "new" for alarm in alarms)
    if args.json:
        print_json({"schema": 1, "wrong": wrong, "told": sent, "known": known, "failures": failures})
    for entry in () if args.json else known:
        print_line(f"known: {entry['about']}: {entry['reason']}")
    if failures:
        raise InfrastructureError("\n".join(failures))
    if not args.json:
        print_line(f"{counted(wrong, 'thing')} wrong")
    return 0


def _worse(args: argparse.Namespace, archive: "Archive", known: "list[Course]") -> "list[Alarm]":
    from rtrun.archive.alarms import worse_builds, worse_courses

    if args.results is None:
        from rtrun.archive.trends import trends

        return worse_courses(trends(known, confidence=args.confidence), confidence=args.confidence)
    from rtrun.archive.against import gate_against
    from rtrun.commands.gate import FALSE_ALARMS
    from rtrun.plan.question import NO_DEADLINE
    from rtrun.results.goal_file import read_goal
    from rtrun.results.record import FILE
    from rtrun.targets.inspection.platform import Platform

    goal = read_goal(args.results)
    asked = goal.question if goal else NO_DEADLINE
    judged = gate_against(
        args.results,
        archive.store,
        deadline_ns=args.deadline or asked.deadline_ns,
        measure=args.measure or asked.of,
        margin_ns=None,
        false_alarms=FALSE_ALARMS,
        platform=Platform.VIRTUAL,
    )
    # A second boot in the same folder belongs to the same build.
    first = min(args.results.rglob(FILE), default=args.results)
    return worse_builds(judged, str(first.read_bytes()), archive.notes, known)
