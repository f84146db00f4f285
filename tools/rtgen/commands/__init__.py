"""The sub-commands of rtgen, one module each; they parse and print, other modules do the work."""

import argparse

# Here and not in rtgen.profile, which imports slowly: `--help` prints it.
DEFAULT_PROFILE = "scarthgap-noetic"


def add_json(parser: argparse.ArgumentParser) -> None:
    """Print JSON instead of words."""
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")
