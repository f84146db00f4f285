"""``rtrun verify``: whether results are unchanged since they were closed, byte for byte."""

import argparse

from rtrun.commands._arguments import add_json, add_results

HELP = "check the files of every run in a results folder against the checksums in its run.json"
EXAMPLES = (
    "rtrun verify results/brakes",
    "rtrun verify results/brakes/001-cyclic_timer_tests",
)
FAILS = "a run is damaged or incomplete"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, files=False)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print a line for every run. 0: all are unchanged, 1: a run is damaged or has no run.json."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line
    from rtrun.results.reading import find_source
    from rtrun.results.record import verify

    source = find_source(args.results)
    if not source.folders:
        raise UsageError(f"{args.results}: not a results folder or a run directory")
    damaged = dict.fromkeys(source.incomplete, "incomplete, it has no run.json")
    whole: dict[str, str] = {}
    for folder in source.folders:
        try:
            record = verify(folder)
            whole[folder.name] = f"{record.status}, {len(record.files)} files"
        except UsageError as error:
            damaged[folder.name] = str(error).splitlines()[0].removeprefix(f"{folder}").lstrip("/: ")
    if args.json:
        print_json({"schema": 1, "damaged": damaged, "whole": whole, "repeated": source.repeated})
        return 1 if damaged else 0
    total = len(source.folders) + len(source.incomplete)
    if damaged:
        print_line(f"{total - len(whole)} of {total} runs are damaged or incomplete")
    else:
        print_line(f"all {total} runs are whole")
    for name, why in damaged.items():
        print_line(f"damaged  {name}: {why}")
    for name, what in whole.items():
        print_line(f"whole    {name}: {what}")
    for name in source.repeated:
        print_line(f"repeated {name}: cut off by a restart of the target, then measured again")
    return 1 if damaged else 0
