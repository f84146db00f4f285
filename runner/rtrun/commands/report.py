"""rtrun report: the answer about all runs in a folder, as one file."""

import argparse
from pathlib import Path

from rtrun.commands._arguments import add_results, add_verbose, named_or_latest
from rtrun.commands._question import add_question, ask

HELP = "write one file: answer, plots, figures"
EXAMPLES = (
    "rtrun report results/brakes",
    "rtrun report results/brakes --output brakes.html --deadline 300us",
)

_ENDINGS = {
    "html": "html",
    "markdown": "md",
    "json": "json",
    "junit": "xml",
    "lava": "lava",
    "csv": "csv",
    "parquet": "parquet",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, latest=True)
    parser.add_argument("--format", choices=list(_ENDINGS), help="[as FILE ends, else html]")
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="file to write, - for standard output [beside RESULTS]"
    )
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    add_question(parser)
    add_verbose(parser)


def run(args: argparse.Namespace) -> int:
    """Print the verdicts, and write the report. Raises UsageError when there is nothing to report on."""
    from rtfiles.errors import InfrastructureError, UsageError
    from rtfiles.output import console, counted, print_bytes, print_line, print_note, print_status
    from rtrun.judgement import gate
    from rtrun.report import formats, page, screen, sentences
    from rtrun.report.contents import contents
    from rtrun.report.plots import pictures

    args.results = named_or_latest(args.results)
    format_ = _format(args.format, args.output)
    if args.open and (format_ != "html" or args.output == Path("-")):
        raise UsageError("--open: opens a page in a browser: write one, with --format html and into a file")
    # The other formats contain no worst cases.
    analysed = ask(args, bounds=format_ in ("html", "markdown", "json"))
    written = contents(analysed)
    judged = gate.gate(analysed)
    writers = {
        "html": lambda: page.html(analysed, written).encode("utf-8", "replace"),
        "markdown": lambda: formats.markdown(written).encode("utf-8", "replace"),
        "json": lambda: formats.as_json(analysed).encode("utf-8", "replace"),
        "junit": lambda: formats.junit(judged).encode("utf-8", "replace"),
        "lava": lambda: formats.lava(analysed, judged).encode(),
        "csv": lambda: formats.as_csv(analysed).encode("utf-8", "replace"),
        "parquet": lambda: formats.parquet(analysed),
    }
    print_status("writing the report")
    content = writers[format_]()
    print_status("")
    if args.output == Path("-"):
        print_bytes(content)
        return 0
    if written.banner:
        print_line(written.banner)
    print_line(written.answer)
    answered = [scenario for scenario in written.scenarios if scenario.group.question]
    if answered:
        console().print(sentences.lines(analysed, answered))
    screen.print_figures([group for group in analysed.answers if group.question is None])
    for text in written.left_out:
        print_line(f"not analysed: {text}")
    for case in judged.cases if args.verbose else ():
        print_line(f"{case.about}: {case.in_full}")
    print_line(f"next: {written.next_step}")
    output = _write(args, _ENDINGS[format_], content)
    logs = [
        log for place in analysed.source.folders for log in sorted(place.glob("*.log")) if log.name != "console.log"
    ]
    try:
        not_drawn = pictures.draw_all(logs or ([args.results] if args.results.suffix == ".log" else []))
    except InfrastructureError as error:
        not_drawn = [f"{counted(len(logs), 'log')}: {error}"]
    for trouble in not_drawn:
        print_note(f"not drawn: {trouble}")
    if format_ == "html":
        _offer(output, opens=args.open)
    else:
        print_line(str(output))
    return 0


def _write(args: argparse.Namespace, ending: str, content: bytes) -> Path:
    """Write the report to the file that was named, else beside the results. Returns the file.

    Raises UsageError where it cannot be written; results may be in a folder that only others write to.
    """
    from rtfiles import atomic
    from rtfiles.errors import UsageError

    named: Path | None = args.output
    if named is not None:
        atomic.write_named(named, content)
        return named
    folder = args.results if args.results.is_dir() else args.results.parent
    name = "report" if args.results.is_dir() else f"{args.results.stem}.report"
    output: Path = folder / f"{name}.{ending}"
    try:
        atomic.write_named(output, content)
    except UsageError as error:
        raise UsageError(f"{error}: name another file by --output") from error
    return output


def _offer(page: Path, *, opens: bool) -> None:
    """Print the address of a page, which terminals make a link of, and open it in a browser where that is asked for."""
    from rtfiles.output import print_line, print_note

    address = page.absolute().as_uri()
    print_line(address)
    if not opens:
        return
    import webbrowser

    if not webbrowser.open(address):
        print_note("rtrun: --open: no browser was found: name one in the variable BROWSER, or open that address")


def _format(given: str | None, output: Path | None) -> str:
    """The format, by name or by the suffix of the file. Raises UsageError where the two differ."""
    from rtfiles.errors import UsageError

    ending = output.suffix.removeprefix(".").lower() if output is not None else ""
    by_ending = next((name for name, suffix in _ENDINGS.items() if suffix == ending), None)
    if given is not None and by_ending not in (None, given):
        raise UsageError(f"--format {given}, --output {output}: a file that ends in .{ending} holds {by_ending}")
    if ending and given is None and by_ending is None:
        endings = ", ".join(f".{suffix}" for suffix in _ENDINGS.values())
        raise UsageError(f"--output {output}: which format? End it in one of {endings}, or name one by --format")
    return given or by_ending or "html"
