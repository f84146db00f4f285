#!/usr/bin/env python3
"""A target that lies instead of watch_probes.sh: what it prints is as the script prints it, and there is no end of it.

lying_observer.py LIE
"""

import itertools
import os
import struct
import sys
import time
from pathlib import Path

TOP = Path(__file__).parents[2]
sys.path[:0] = [str(TOP / folder) for folder in ("runner", "tools", "tests")]
from watched import COMMON, FIELD, HEADERS, PRINT, SWITCH, a_round, event, mark, page  # noqa: E402

PUBLISH = f"""name: publish_0_0
ID: 1501
{COMMON}
\tfield:u64 endpoint;\toffset:8;\tsize:8;\tsigned:0;
\tfield:s64 source_ns;\toffset:16;\tsize:8;\tsigned:1;
\tfield:__data_loc char[] topic;\toffset:24;\tsize:4;\tsigned:1;
"""
TAKE = PUBLISH.replace("publish_0_0", "take_0_1").replace("1501", "1500")
CALLBACK = f"""name: callback_begin_0_2
ID: 1502
{COMMON}
\tfield:u64 callback;\toffset:8;\tsize:8;\tsigned:0;
"""
STAT = " S 1 1 1 0 -1 4194368 1 0 0 0 0 0 0 0 20 0 18 0 227595 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 17 1 0 0 0 0 0"
PUBLISHED, TAKEN, CALLBACK_ID = 1501, 1500, 1502
TEXTS_AT = 28
"""Where fields of a message begin that no probe asked for."""
BEGIN_NS = 10**9
PAGES = 2000


def message(kind: int, tid: int, endpoint: int, source_ns: int, topic: bytes) -> bytes:
    """A hit of publishing or taking."""
    text = topic + b"\0"
    body = struct.pack("<HBBiQqI", kind, 0, 0, tid, endpoint, source_ns, (len(text) << 16) | 28) + text
    return body + bytes(-len(body) % 4)


def hits(lie: str):
    """The hits of a lie, without an end."""
    for n in itertools.count():
        if lie == "callbacks":
            yield struct.pack("<HBBiQ", CALLBACK_ID, 0, 0, 7, n)
            continue
        tid = 7 if lie != "threads" else 1 + n % (1 << 22)
        endpoint = n if lie == "endpoints" else 1
        topic = b"/a"
        if lie == "topics":
            topic = b"/%d" % (n // 2)
        elif lie == "texts":
            topic = b"/%d" % (n // 2) + b"\xf0\x9f\x98\x80" * 100
        elif lie == "pages":
            topic = b"/a" * 1900
        elif lie == "one text":
            text = b"/a" * 1000 + b"\0"
            names = [len(text) << 16 | (TEXTS_AT + 4 * 190)] * 191
            yield struct.pack("<HBBiQq191I", PUBLISHED, 0, 0, 7, 1, n, *names) + text + bytes(-(len(text) + 788) % 4)
            continue
        if lie == "traces":
            if n % 2:
                # Between a publication and its reception.
                for thread in range(20):
                    yield struct.pack("<HBBi16siiq16sii", 300, 1, 0, 7, b"hog", thread, 50, 1, b"l%d" % n, n, 120)
            topic = b"/%d" % (n // 2 % 1000)
            yield struct.pack("<HBBiQ", CALLBACK_ID, 0, 0, n % 1000, n % 5000)
        source_ns = 5 if lie == "stamps" else n // 2
        yield message(
            (PUBLISHED, TAKEN)[n % 2 if lie != "stamps" else n // 50_000 % 2], tid, endpoint, source_ns, topic
        )


def pages(lie: str):
    """Pages full of hits that are nanoseconds apart: those that were made beforehand, again and again, in new times."""
    source, ready = hits(lie), []
    for _ in range(PAGES):
        data = b""
        while len(data) < (100 if lie in ("pages", "one text") else 3500):
            data += event(1, next(source))
        ready.append(page(BEGIN_NS, data)[8:])
    return (
        # The time goes on by a second with each million.
        struct.pack("<Q", BEGIN_NS + (number * 1000 if lie != "still" else 0)) + ready[number % PAGES]
        for number in itertools.count()
    )


def say(data: bytes) -> None:
    """Print all of it."""
    view = memoryview(data)
    while view:
        view = view[os.write(1, view) :]


def main() -> None:
    """Lie until the reader goes away."""
    lie = sys.argv[1]
    if lie == "no line":
        while True:
            say(b"x" * 4096)
    if lie == "errors":
        while True:
            os.write(2, b"x" * 4095 + b"\n")
    formats = {"publish_0_0": PUBLISH, "take_0_1": TAKE, "callback_begin_0_2": CALLBACK}
    if lie == "one text":
        more = "".join(FIELD.format("__data_loc char[]", f"x{n}", TEXTS_AT + 4 * n, 4, 1) for n in range(190))
        formats["publish_0_0"] += more
    head = f"rtrun observes\nheader_page\n{HEADERS[64]}rtrun end header_page\n"
    head += "".join(f"placed {name}\n" for name in formats)
    formats_by_path = {f"rtrun_observe_1_2_3/{name}": text for name, text in formats.items()} | {"ftrace/print": PRINT}
    formats_by_path["/events/sched/sched_switch"] = SWITCH
    head += "".join(f"format {name}/format\n{text}rtrun end format\n" for name, text in formats_by_path.items())
    say(f"{head}ready\n".encode())
    begin_ns = BEGIN_NS - 10 if lie != "clock" else 1 << 62
    say(a_round(1, cpu0=page(begin_ns, event(0, mark("observes")) + event(1, mark("round 1")))))
    if lie in ("silence", "drip"):
        while True:
            time.sleep(1)
            say(b"r" * (lie == "drip"))
    if lie == "ready again":
        for number in itertools.count(2):
            at_ns = BEGIN_NS + number * 10**9
            say(a_round(number, cpu0=page(at_ns, event(0, mark(f"round {number}")))) + b"ready\n")
            time.sleep(0.5)
    if lie == "late":
        topics = pages("topics")
        for number in itertools.count(2):
            at_ns = BEGIN_NS + number * 10**9
            say(a_round(number, cpu0=page(at_ns, event(0, mark(f"round {number}")))) + b"pages 0\n")
            # Of the second round they are in time, and later ones have the times of that again.
            say(b"".join(struct.pack("<Q", BEGIN_NS + 10**9) + next(topics)[8:] for _ in range(1000)))
            say(b"rtrun end pages\n")
    if lie == "placed":
        while True:
            say(b"placed take_0_1\n" * 4096)
    if lie == "rounds":
        for number in itertools.count(2):
            say(b"round %d\nended 5\n" % number)
    if lie == "programs":
        say(b"programs\n")
        for pid in itertools.cycle(range(1, 1 << 22)):
            lines = [f"program {pid}", *(f"argument {'y' * 60_000}" for _ in range(3))]
            lines += [f"stat {pid} (x){STAT}", f"cpus {pid} {pid % 4000}-8191", "maps 1-2 fe:00 5 /x/librcl.so"]
            say("".join(f"{line}\n" for line in (*lines, f"end {pid}")).encode())
    if lie == "cpu sets":
        for number in itertools.count(2):
            lines = [f"stat {tid} (x){STAT}\ncpus {tid} {number}-{8000 - tid}" for tid in range(1, 251)]
            block = "\n".join(["programs", "program 1", *lines, "maps 1-2 fe:00 5 /x/librcl.so", "end 1", ""])
            block = block.replace("227595", str(number), 1)
            at_ns = BEGIN_NS + number * 1000
            say(a_round(number, cpu0=page(at_ns, event(0, mark(f"round {number}")))))
            say(f"{block}rtrun end programs\n".encode())
    if lie in ("clock", "clock that jumps"):
        for number in itertools.count(2):
            at_ns = begin_ns + number if number < 6 else (1 << 63) - 1000
            say(a_round(number, cpu0=page(at_ns, event(0, mark(f"round {number}")) + event(1, next(hits(lie))))))
            time.sleep(0.1)
    if lie == "a program":
        say(b"programs\nprogram 1\n")
        while True:
            say(f"stat 2 (x){STAT}\n".encode() * 100)
    if lie == "gaps":
        lost = page(BEGIN_NS, b"", flags=1 << 31)
        say(b"pages 0\n")
        while True:
            say(lost * 100)
    endless = pages(lie)
    if lie == "one round":
        say(b"round 2\npages 0\n")
        while True:
            say(next(endless))
    end_s = time.monotonic() + 1
    for number in itertools.count(2):
        at_ns = BEGIN_NS + number * 10**9
        say(a_round(number, cpu0=page(at_ns, event(0, mark(f"round {number}")))) + b"pages 0\n")
        while time.monotonic() < end_s:
            say(b"".join(itertools.islice(endless, 16)))
        say(b"rtrun end pages\n")
        end_s += 1


if __name__ == "__main__":
    main()
