"""rtrun show: the figures of a run, of all runs of a campaign, of one log, or of one output's samples."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Group

NAME = "show"
HELP = "show the figures of a run, of all runs in a folder, of a log, or of samples"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The path, and how to print."""
    parser.add_argument("path", type=Path, help="run directory, folder of runs, .log, .npy or .json of a suite")
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def run(args: argparse.Namespace) -> int:
    """Print the answer. Raises UsageError for what cannot be shown."""
    import json

    from rtfiles.errors import UsageError
    from rtfiles.output import console, print_text

    data, answer, refused = _read(args.path)
    if args.json:
        print_text(json.dumps(data, indent=2, allow_nan=False))
    else:
        console().print(answer, crop=False)
    if refused:
        raise UsageError("\n".join(refused))
    return 0


def _read(path: Path) -> "tuple[dict[str, Any], Group, tuple[str, ...]]":
    """What is there as plain data, as an answer to print, and what was refused."""
    from rtfiles.errors import UsageError
    from rtrun.report import terminal
    from rtrun.results import reading

    if path.is_dir():
        if reading.is_closed(path) or not any(child.is_dir() for child in path.iterdir()):
            one = reading.read_run(path)
            return {"schema": 1, **_run_data(one)}, terminal.answer_of_run(one), ()
        found = reading.read_runs(path)
        data = {
            "schema": 1,
            "emulated": any(one.record.emulated for one in found.runs),
            "runs": [_run_data(one) for one in found.runs],
            "incomplete": list(found.incomplete),
        }
        return data, terminal.answer_of_runs(found), found.refused
    if not path.is_file():
        raise UsageError(f"{path}: no such file or directory")
    if path.suffix == ".log":
        log = reading.result_of_log(path)
        return {"schema": 1, **log.as_json()}, terminal.answer([log], emulated=False), ()
    if path.suffix in (".npy", ".json"):
        samples = reading.results_of_samples(path)
        data = {"schema": 1, "results": [result.as_json() for result in samples]}
        return data, terminal.answer(samples, emulated=False), ()
    raise UsageError(f"{path}: not a run directory, a folder of runs, or a .log, .npy or .json of a suite")


def _run_data(one: Any) -> dict[str, Any]:
    record = one.record
    told = ("run", "campaign", "suite", "parameters", "emulated", "status", "reason", "start_time", "end_time")
    return {**{key: getattr(record, key) for key in told}, "results": [result.as_json() for result in one.results]}
