"""rtrun show: the figures of a run, of all runs of a campaign, of one log, or of one output's samples."""

import argparse
import atexit
import gc
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._arguments import add_json, add_results, named_or_latest

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import Group

    from rtrun.analysis.figures import IndexedValue
    from rtrun.results.reading import ClosedRun
    from rtrun.results.series import Result

HELP = "show the figures of a run, of all runs in a folder, of a log, or of samples"
EXAMPLES = (
    "rtrun show results/brakes",
    "rtrun show oneshot_timer_tests.log --json",
)
_TIMES = ("min", "mean", "max", "p50", "p90", "p99", "p99.9")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, latest=True)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the answer. Raises UsageError for what cannot be shown."""

    from rtfiles.errors import UsageError
    from rtfiles.output import console, print_json

    args.results = named_or_latest(args.results)
    atexit.register(_leave_garbage)
    data, answer, refused = _read(args.results)
    if args.json:
        print_json(data)
    else:
        console().print(answer)
    if refused:
        raise UsageError("\n".join(refused))
    return 0


def _leave_garbage() -> None:
    """Keep Python from searching everything loaded for garbage at exit: it takes half as long as loading numpy."""
    # A program that calls this may have loaded duckdb, which would then print what is left of it.
    if "duckdb" not in sys.modules:
        gc.freeze()


def _read(path: Path) -> "tuple[dict[str, Any], Group, tuple[str, ...]]":
    """The content of a path as plain data, as an answer to print, and what was refused."""
    from rtfiles.errors import UsageError
    from rtrun.report import terminal
    from rtrun.targets.inspection.platform import Platform, weakest

    if path.is_dir():
        # Reading one file takes less time than loading these.
        from rtrun.results import reading
        from rtrun.results.record import is_closed

        if is_closed(path) or not any(child.is_dir() for child in path.iterdir()):
            closed = reading.read_run(path)
            return {"schema": 2, **_run_data(closed)}, terminal.answer_of_run(closed), ()
        of_folder = reading.read_runs(path)
        data = {
            "schema": 2,
            "platform": weakest(run.record.platform for run in of_folder.runs),
            "runs": [_run_data(run) for run in of_folder.runs],
            "incomplete": list(of_folder.incomplete),
        }
        return data, terminal.answer_of_runs(of_folder), of_folder.refused
    if not path.is_file():
        raise UsageError(f"{path}: no such file or directory")
    from rtrun.results.series import read_file, results_of

    results = results_of(read_file(path))
    data = (
        {"results": [_result_data(result) for result in results]} if path.suffix != ".log" else _result_data(results[0])
    )
    return {"schema": 1, **data}, terminal.answer(results, platform=Platform.HARDWARE), ()


def _run_data(run: "ClosedRun") -> dict[str, Any]:
    record = run.record
    keys = (
        "run",
        "campaign",
        "suite",
        "parameters",
        "platform",
        "platform_evidence",
        "status",
        "reason",
        "start_time",
        "end_time",
    )
    rates = {name: rate.model_dump() for name, rate in record.rates.items()}
    head = {**{key: getattr(record, key) for key in keys}, "rates": rates}
    return {**head, "results": [_result_data(result) for result in run.results]}


def _result_data(result: "Result") -> dict[str, Any]:
    """What a series is, then its figures in microseconds, as docs/formats.md describes it."""
    from rtrun.analysis.figures import PERCENTILE_METHOD
    from rtrun.report.quantities import identity, lost, times_ns, us
    from rtrun.report.terminal import remarks_of

    header, figures = result.header, result.figures
    return {
        **identity(header),
        "n": figures.n,
        # docs/formats.md names p99.9 without its point here.
        **{f"{name.replace('.', '')}_us": us(times_ns(figures)[name]) for name in _TIMES},
        "percentile_method": PERCENTILE_METHOD,
        "top": _values(figures.top),
        "lowest": _values(figures.lowest),
        "startup": _values(header.startup),
        **lost(header),
        "resolution_ns": figures.bin_ns,
        "remarks": remarks_of(header),
    }


def _values(values: "Iterable[IndexedValue]") -> list[dict[str, float | int | None]]:
    from rtrun.report.quantities import us

    return [{"value_us": us(value.value_ns), "index": value.index} for value in values]
