"""rtgen flash: write an image to a card or stick."""

import argparse
import sys
from pathlib import Path

from rtgen.commands import add_json

HELP = "write an image to an SD card or USB stick and read it back"
EXAMPLES = (
    "rtgen flash --image card.img --device /dev/mmcblk0 --yes",
    "rtgen flash --image image.wic --device /dev/sdX",
)
FAILS = "it was not confirmed, and nothing was written"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--image",
        type=Path,
        required=True,
        metavar="FILE",
        help="the .wic file of BitBake, or card.img of rtgen board build",
    )
    parser.add_argument(
        "--device", type=Path, required=True, metavar="/dev/sdX", help="the card, not a partition of it"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line, print_status
    from rtgen import flash

    if args.json and not args.yes:
        raise UsageError("--json goes with --yes: the question would stand in the answer")
    size = flash.check_image(args.image)
    card = flash.check_device(args.device, size)
    if args.json:
        digest = flash.write(args.image, size, card, lambda *_: None)
        print_json({"schema": 1, "device": str(card.path), "bytes": size, "sha256": digest})
        return 0
    print_line(f"{args.image} ({size} bytes) -> {card.path}: {card.model}, {card.size_bytes} bytes.")
    print_line(f"Everything on {card.path} will be lost.")
    if not args.yes:
        # Python sets a closed standard input to None.
        if not sys.stdin or not sys.stdin.isatty():
            raise UsageError("standard input is no terminal, so nobody can confirm: give --yes")
        try:
            answer = input(f"Type {card.name} to go on: ")
        except EOFError:
            answer = ""
            print_line()
        if answer.strip() != card.name:
            print_line("Nothing was written.")
            return 1

    def show(what: str, done: int) -> None:
        print_status(f"{what} {done * 100 // size} %")

    digest = flash.write(args.image, size, card, show)
    print_status("")
    print_line(f"{card.path}: {size} bytes written and verified, sha256 {digest}")
    return 0
