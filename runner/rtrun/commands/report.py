"""rtrun report: the answer about all runs in a folder, as one file."""

import argparse
from pathlib import Path

from rtrun.commands._question import add_question, ask

NAME = "report"
HELP = "write one file: answer, plots, figures, claims"

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
    """The results, the format, the question."""
    parser.add_argument("results", type=Path, help="folder of runs, run directory, .log or .npy of a suite")
    parser.add_argument("--format", choices=list(_ENDINGS), default="html", help="[html]")
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="file to write, - for standard output [beside RESULTS]"
    )
    add_question(parser)


def run(args: argparse.Namespace) -> int:
    """Write the report, and say the verdicts. Raises UsageError when there is nothing to report on."""
    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.output import print_bytes, print_line, print_note
    from rtrun.report import answers, formats, gate, page
    from rtrun.report.claims.examiners import examine_claims
    from rtrun.report.contents import contents
    from rtrun.report.plots import pictures

    # The other formats hold neither worst cases nor claims.
    whole = args.format in ("html", "markdown", "json")
    analysed = ask(args, bounds=whole)
    examined = examine_claims(analysed) if whole else ()
    written = contents(analysed, examined)
    judged = gate.gate(analysed)
    writers = {
        "html": lambda: page.html(analysed, written).encode("utf-8", "replace"),
        "markdown": lambda: formats.markdown(written).encode("utf-8", "replace"),
        "json": lambda: formats.as_json(analysed, examined).encode("utf-8", "replace"),
        "junit": lambda: formats.junit(judged).encode("utf-8", "replace"),
        "lava": lambda: formats.lava(analysed, judged).encode(),
        "csv": lambda: formats.as_csv(analysed).encode("utf-8", "replace"),
        "parquet": lambda: formats.parquet(analysed),
    }
    content = writers[args.format]()
    if args.output == Path("-"):
        print_bytes(content)
        return 0
    ending = _ENDINGS[args.format]
    folder = args.results if args.results.is_dir() else args.results.parent
    name = "report" if args.results.is_dir() else f"{args.results.stem}.report"
    output = args.output or folder / f"{name}.{ending}"
    try:
        atomic.write_bytes(output, content)
    except OSError as error:
        raise UsageError(f"{output}: {error.strerror}") from error
    logs = [
        log for place in analysed.source.folders for log in sorted(place.glob("*.log")) if log.name != "console.log"
    ]
    for trouble in pictures.draw_all(logs or ([args.results] if args.results.suffix == ".log" else [])):
        print_note(f"not drawn: {trouble}")
    if written.banner:
        print_line(written.banner)
    print_line(written.answer)
    answers.print_answers(judged.cases, judged=False)
    print_line(str(output))
    return 0
