"""Arguments that several commands take, each with one name and one meaning."""

import argparse
import os
from pathlib import Path

import rtrun

# The campaigns of the repository, which the Python package also contains.
CAMPAIGNS = Path(rtrun.__file__).with_name("plan") / "campaigns"
# The target file when a command names none.
TARGET_VARIABLE = "RTRUN_TARGET"


def add_campaign(parser: argparse.ArgumentParser, *, otherwise: str = "") -> None:
    """The campaign file, by its path or by the name of a shipped campaign; `otherwise`: what is done without one."""
    names = ", ".join(path.stem for path in shipped_campaigns())
    parser.add_argument(
        "campaign",
        type=campaign_file,
        nargs="?" if otherwise else None,
        metavar="CAMPAIGN",
        help=f"a file, or one of {names}" + (f" [{otherwise}]" if otherwise else ""),
    )
    parser.add_argument(
        "-k",
        dest="expression",
        metavar="EXPRESSION",
        help="only the runs whose names it is true of, as pytest chooses tests: 'cyclic and not fq1000'",
    )


def shipped_campaigns() -> list[Path]:
    """The files of the shipped campaigns, by name."""
    return sorted(CAMPAIGNS.glob("*.yml"))


def campaign_file(text: str) -> Path:
    """The file at this path; if there is none, the shipped campaign of that name."""
    path, shipped = Path(text), CAMPAIGNS / f"{text}.yml"
    return shipped if path.name == text and not path.exists() and shipped.is_file() else path


def add_target(parser: argparse.ArgumentParser) -> None:
    """The one target, a file or a login; required if the environment names none."""
    given = os.environ.get(TARGET_VARIABLE)
    parser.add_argument(
        "--target",
        type=Path,
        required=not given,
        default=given and Path(given),
        metavar="TARGET",
        help=f"TARGET.yml, or [USER@]HOST[:PORT] [{TARGET_VARIABLE} of the environment]",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Print JSON instead of words."""
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")


def add_results(parser: argparse.ArgumentParser, *, files: bool = True, latest: bool = False) -> None:
    """The results; `files`: also files that a suite wrote outside a run; `latest`: else the newest."""
    takes = ", or a .log, .npy or .json of a suite" if files else ""
    parser.add_argument(
        "results",
        type=Path,
        nargs="?" if latest else None,
        metavar="RESULTS",
        help=f"folder of runs or one run directory{takes}" + (" [results/latest]" if latest else ""),
    )


def named_or_latest(results: Path | None) -> Path:
    """The results that the arguments name, else the newest, which a remark names. Raises UsageError as that does."""
    if results is not None:
        return results
    from rtfiles.output import print_note
    from rtrun.results.latest import LINK, latest_results

    newest = latest_results()
    print_note(f"rtrun: {newest}, the newest ({LINK})")
    return newest


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """Whether every answer is explained."""
    parser.add_argument("-v", "--verbose", action="store_true", help="say what each answer rests on, and what it lacks")
