"""``rtrun farm``: the places of a labgrid farm, and a check of each."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._archive import reach
from rtrun.commands._arguments import add_json

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import date

    from rtrun.archive.runs import RunRow
    from rtrun.targets.config import LabgridConfig
    from rtrun.targets.labgrid.coordinator import LabgridPlace, OfferedResource

HELP = "show each place of a labgrid farm: state, last run, temperature, power; --check tries each"
EXAMPLES = (
    "rtrun farm --archive archive",
    "rtrun farm --target lab.yml --check",
)
FAILS = "with --check: a place failed"
CHECKS_AT_ONCE = 8  # each has two processes of labgrid's client, about 50 MiB
_UNKNOWN = "-"
_COLUMNS = ("place", "state", "console", "power cycles", "last run", "platform", "kernel", "max °C")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--target",
        type=Path,
        metavar="TARGET.yml",
        help="of kind labgrid: its coordinator, places and keys [all places of LG_COORDINATOR]",
    )
    parser.add_argument("--archive", metavar="ARCHIVE", help="where the last runs are")
    parser.add_argument(
        "--check",
        action="store_true",
        help="log in to each place that is free; one that fails twice in a row gets the tag quarantine, by which rtrun "
        "run leaves it out, and one that passes loses it",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print a row for each place, or the result of its check. 1: a check failed, 3: the coordinator does not answer."""
    from rtfiles.errors import UsageError
    from rtrun.targets.config import LabgridConfig, parse_target, read_target, wanted_place
    from rtrun.targets.labgrid.coordinator import list_places, list_resources, matching

    any_place = {"schema": 1, "name": "farm", "kind": "labgrid", "place": "*"}
    config = read_target(args.target) if args.target else parse_target(any_place, "farm")
    if not isinstance(config, LabgridConfig):
        raise UsageError(f"{args.target}: kind: {config.kind}: a farm is that of kind: labgrid")
    folder = args.target.parent if args.target else Path()
    wanted = wanted_place(config, folder)
    places = matching(list_places(wanted.coordinator), wanted.tags if args.target else {})
    if not places:
        raise UsageError(f"the labgrid coordinator at {wanted.coordinator} has no such place")
    offered = list_resources(wanted.coordinator)
    if args.check:
        return _check_all(wanted.coordinator, config, folder, places, offered, as_json=args.json)
    last = {}
    if args.archive:
        from rtrun.archive.runs import last_runs, read_archive

        last = last_runs(read_archive(reach(args.archive)).runs)
    facts = [_facts(place, offered, last.get(place.name)) for place in places]
    _print(facts, with_runs=bool(args.archive), as_json=args.json)
    return 0


def _facts(place: "LabgridPlace", offered: "Sequence[OfferedResource]", last: "RunRow | None") -> dict[str, Any]:
    """What is known about a place, for JSON; None: not known."""
    from rtrun.targets.labgrid.coordinator import has_power, resources_of, unoffered
    from rtrun.targets.labgrid.health import FAILED
    from rtrun.targets.labgrid.places import power_cycles

    resources = resources_of(place, offered)
    missing = unoffered(place, offered)
    serial = [resource for resource in resources if "SerialPort" in resource.kind]
    run = None
    if last is not None:
        names = ("run", "scenario", "start_utc", "status", "platform", "kernel_release", "temperature_max_mc")
        run = {name: getattr(last, name) for name in names}
        run["start_utc"] = last.start_utc and f"{last.start_utc.isoformat()}Z"
    return {
        "place": place.name,
        "tags": dict(place.tags),
        "holder": place.holder,
        "is_reserved": place.reservation is not None,
        "quarantine": place.quarantine,
        "failed_check": place.tags.get(FAILED),
        "not_offered": missing,
        "console": None if missing else "none" if not serial else "yes" if serial[0].is_available else "away",
        "has_power_switch": None if missing else has_power([resource.kind for resource in resources]),
        "power_cycles": power_cycles(place),
        "last_run": run,
    }


def _print(facts: "Sequence[dict[str, Any]]", *, with_runs: bool, as_json: bool) -> None:
    from rtfiles.output import console, counted, print_json, print_line, print_note
    from rtrun.report.tables import Table

    if as_json:
        print_json({"schema": 1, "places": facts})
        return
    bad = [place for place in facts if place["quarantine"] or place["not_offered"]]
    print_line(f"{counted(len(facts), 'place')}, {len(bad)} of them cannot be measured on")
    known = len(_COLUMNS) if with_runs else _COLUMNS.index("last run")
    rows = [_row(place)[:known] for place in facts]
    console().print(Table(columns=_COLUMNS[:known], rows=rows, numbers=(3, 7)))
    if not with_runs:
        print_note("rtrun: --archive ARCHIVE knows the last run of each")


def _row(facts: dict[str, Any]) -> tuple[str, ...]:
    run = facts["last_run"]
    if run is None:
        last, platform, kernel, celsius = [_UNKNOWN] * 4
    else:
        when = run["start_utc"][:16].replace("T", " ") if run["start_utc"] else "at an unknown time"
        last = f"{when} {run['scenario']}{'' if run['status'] == 'ok' else ': ' + run['status']}"
        platform = run["platform"]
        kernel = run["kernel_release"] or _UNKNOWN
        celsius = f"{run['temperature_max_mc'] / 1000:.1f}" if run["temperature_max_mc"] else _UNKNOWN
    switch = facts["has_power_switch"]
    power = "no switch" if switch is False else str(facts["power_cycles"])
    return facts["place"], _state(facts), facts["console"] or _UNKNOWN, power, last, platform, kernel, celsius


def _state(facts: dict[str, Any]) -> str:
    from rtrun.targets.labgrid.coordinator import nobody_offers
    from rtrun.targets.labgrid.health import in_words

    parts = []
    if facts["quarantine"]:
        parts.append(f"QUARANTINE: {in_words(facts['quarantine'])}")
    if facts["not_offered"]:
        parts.append(nobody_offers(facts["not_offered"]))
    if facts["failed_check"]:
        parts.append(f"failed its last check: {in_words(facts['failed_check'])}")
    if facts["holder"]:
        parts.append(f"held by {facts['holder']}")
    elif facts["is_reserved"]:
        parts.append("reserved")
    return "; ".join(parts) or "free"


def _check_all(
    coordinator: str,
    config: "LabgridConfig",
    folder: Path,
    places: "Sequence[LabgridPlace]",
    offered: "Sequence[OfferedResource]",
    *,
    as_json: bool,
) -> int:
    """Check places, several at a time, and print a line for each when it is done. 1: a check failed."""
    from concurrent.futures import ThreadPoolExecutor
    from datetime import UTC, datetime
    from functools import partial

    from rtfiles.output import print_json, print_line

    today = datetime.now(UTC).date()
    checked = []
    with ThreadPoolExecutor(CHECKS_AT_ONCE) as threads:
        for place, (outcome, text) in zip(
            places, threads.map(partial(_check, coordinator, config, folder, today, offered), places), strict=True
        ):
            checked.append({"place": place.name, "outcome": outcome, "text": text})
            if not as_json:
                print_line(f"{place.name}  {outcome}: {text}")
    if as_json:
        print_json({"schema": 1, "checks": checked})
    return int(any(check["outcome"] not in ("passed", "not checked") for check in checked))


def _check(
    coordinator: str,
    config: "LabgridConfig",
    folder: Path,
    today: "date",
    offered: "Sequence[OfferedResource]",
    place: "LabgridPlace",
) -> tuple[str, str]:
    """Check a place and set its tags; returns the outcome, and details."""
    import getpass

    from rtrun.commands._link import linked
    from rtrun.targets.errors import TargetError, TargetGone
    from rtrun.targets.inspection.health import check_health
    from rtrun.targets.labgrid import health
    from rtrun.targets.labgrid.coordinator import QUARANTINE, LabgridClient, find_place, resources_of

    kinds = {resource.kind for resource in resources_of(place, offered)}
    if kinds and "NetworkService" not in kinds:
        return "not checked", f"it has no NetworkService, only {', '.join(sorted(kinds))}"
    of_place = config.model_copy(update={"place": place.name, "filter": {}})
    failure, text = None, ""
    try:
        with linked(of_place, folder, about=f"{place.name}: ", is_check=True) as link:
            text = check_health(link)
    except TargetGone as error:
        return "not checked", str(error)
    except TargetError as error:
        failure = str(error)
    # Ask again: a missing coordinator is not the board's fault, and somebody may have set tags meanwhile.
    now = find_place(coordinator, place.name)
    tags = now.tags if now else {}
    changed = health.after_success(tags) if failure is None else health.after_failure(tags, failure, today)
    LabgridClient(coordinator=coordinator, user=getpass.getuser()).set_tags(place.name, changed)
    if failure is None:
        return "passed", f"{text}; its quarantine is over" if QUARANTINE in tags else text
    is_first = QUARANTINE not in tags and QUARANTINE not in changed
    return ("failed" if is_first else "in quarantine"), failure
