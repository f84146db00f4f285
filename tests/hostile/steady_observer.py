#!/usr/bin/env python3
"""A target instead of watch_probes.sh that needs no kernel trace: a message in each of five rounds a second.

steady_observer.py [AT WORD]    in round AT it does what WORD says; with `end` instead of AT, when it is told to end
"""

import os
import select
import sys
import time
from pathlib import Path

TOP = Path(__file__).parents[2]
sys.path[:0] = [str(TOP / folder) for folder in ("runner", "tools", "tests")]
from hostile.lying_observer import PUBLISH, PUBLISHED, STAT, TAKE, TAKEN, message, say  # noqa: E402
from watched import HEADERS, PRINT, a_round, event, mark, page  # noqa: E402

FORMATS = {"publish_0_0": PUBLISH, "take_0_1": TAKE}
PROGRAM = f"""programs
program 7
argument listener
locked {{locked}} kB
stat 7 (listener) S{STAT.removeprefix(" S")}
cpus 7 {{cpus}}
maps 1-2 fe:00 5 /x/librcl.so
end 7
rtrun end programs
"""
LIES = {
    "locked": PROGRAM.format(locked=2**53 - 1, cpus="0"),
    "cpus": PROGRAM.format(locked=4, cpus="0-8192"),
    "ready": "ready\n",
    "name": PROGRAM.format(locked=4, cpus="0").replace("listener", "\x1b[31m\u2028\U0001f600\x7f" * 20),
}


def do(word: str) -> None:
    """A lie, or a time in seconds in which nothing is printed."""
    if word == "same time":
        kinds = (PUBLISHED, TAKEN) * 40
        data = b"".join(event(n // 79, message(kind, 7, kind, n // 2 * 1000, b"/b")) for n, kind in enumerate(kinds))
        say(b"pages 0\n" + page(time.monotonic_ns(), data) + b"rtrun end pages\n")
    elif word in LIES:
        say(LIES[word].encode())
    else:
        time.sleep(float(word))


def main() -> None:
    """Until standard input ends, as of the runner."""
    at, word = (*sys.argv[1:3], "", "")[:2]
    head = f"rtrun observes\nheader_page\n{HEADERS[64]}rtrun end header_page\n"
    head += "".join(f"placed {name}\n" for name in FORMATS)
    formats_by_path = {f"rtrun_observe_1_2_3/{name}": text for name, text in FORMATS.items()} | {"ftrace/print": PRINT}
    head += "".join(f"format {name}/format\n{text}rtrun end format\n" for name, text in formats_by_path.items())
    say(f"{head}ready\n".encode())
    number, is_over = 0, False
    while not is_over:
        number += 1
        data = event(0, mark("observes")) if number == 1 else b""
        data += event(1, mark(f"round {number}")) + event(9, message(PUBLISHED, 7, 1, 1000 * number, b"/a"))
        data += event(1000 * number, message(TAKEN, 7, 2, 1000 * number, b"/a"))
        say(a_round(number, cpu0=page(time.monotonic_ns(), data)))
        if at == str(number):
            do(word)
        end_s = time.monotonic() + 0.2
        while not is_over and (left_s := end_s - time.monotonic()) > 0:
            if select.select([0], [], [], left_s)[0]:
                is_over = not os.read(0, 4096)
    if at == "end":
        do(word)
    say(b"rounds end\nrtrun end done\n")


if __name__ == "__main__":
    main()
