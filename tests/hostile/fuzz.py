"""Mutation fuzz of every reader: whatever it is given, it ends with a result or with an error of ours.

No traceback, no hang, at most MEMORY_MIB. Numbers are drawn at and beyond every limit that a reader has.
Run: make fuzz SECONDS=600 SEED=7; or this program, with runner and tests in PYTHONPATH, --only journal run
"""

import argparse
import contextlib
import copy
import itertools
import json
import random
import re
import shutil
import signal
import sqlite3
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from readers import READERS, Files

from measured import own_peak_mib
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.analysis.histogram import LIMIT_NS
from rtrun.kinds import limits
from rtrun.plan import conditions, suites

# The libraries of all commands take 320 of it.
MEMORY_MIB = 400
INPUT_S = 60
TOKENS = [b"\0", b"\xff", b"-1", b"9" * 5000, b"1e9999", b"\n", b"{", b"[" * 2000, b"\xc2\xb2", b"*", b"&a ", b": "]
# What a value of JSON, YAML or SQL may become.
VALUES: list[Any] = [
    None, True, 0, -1, 2**63, 10**19, 10**30, 1e308, float("inf"), float("nan"), -0.5, "", "x" * 5000, "9" * 5000,
    "\ud800", "\0", "\x1b[31m", "\u00b2", "\u2028", "../../x", "/", ".", "=1+1", "2026-11-21", "0-999999999", [], {},
    [[]] * 100, {"x": "y"}, json.loads("[" * 100 + "]" * 100),
]  # fmt: skip


# What a number may become: every limit, and those beside it.
_LIMITS = {
    *(value for name, value in vars(limits).items() if name.isupper() and isinstance(value, int)),
    *(bound for option in (*suites.options().values(), *conditions.conditions().settings.values())
      for bound in (option.min, option.max)),
    *(2**power for power in (15, 16, 31, 32, 53, 59, 60, 61, 62, 63)), LIMIT_NS,
}  # fmt: skip
NUMBERS = sorted({sign * limit + beside for limit in _LIMITS for sign in (-1, 1) for beside in (-1, 0, 1)})
INT64_NUMBERS = [number for number in NUMBERS if -(2**63) <= number < 2**63]
TIMES = ["0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "1969-12-31", "2262-04-12T00:00:00Z", "unknown"]
VALUES += [*NUMBERS[:: len(NUMBERS) // 30], *TIMES]


def damaged(random_: random.Random, name: str, data: bytes) -> bytes:
    """A file with its bytes changed or, where it has a structure, with the structure whole and its values changed."""
    if random_.random() < 0.5:
        with contextlib.suppress(ValueError, yaml.YAMLError, sqlite3.Error, IndexError, OverflowError):
            if name.endswith(".sqlite"):
                return _with_other_cells(random_, data)
            if name.endswith((".json", ".yml")):
                return _with_other_values(random_, data)
            if name.endswith(".npy"):
                return _with_other_rows(random_, data)
            return _with_other_numbers(random_, data)
    return _with_other_bytes(random_, data)


def _with_other_bytes(random_: random.Random, data: bytes) -> bytes:
    for _ in range(random_.randint(1, 6)):
        start = random_.randint(0, len(data))
        end = min(len(data), start + random_.randint(0, 40))
        middle = random_.choice([b"", random_.choice(TOKENS), random_.randbytes(4), data[start:end] * 20])
        data = data[:start] + middle + data[end:]
    return data


def _with_other_rows(random_: random.Random, data: bytes) -> bytes:
    start = 10 + int.from_bytes(data[8:10], "little")
    values = np.frombuffer(data, "<i8", offset=start).copy()
    for _ in range(random_.randint(1, 4)):
        values[random_.randrange(values.size)] = random_.choice(INT64_NUMBERS)
    return data[:start] + values.tobytes()


def _with_other_numbers(random_: random.Random, data: bytes) -> bytes:
    """A text in which some of the numbers are others."""
    for _ in range(random_.randint(1, 3)):
        place = random_.choice(list(re.finditer(rb"-?[0-9]+", data)))
        data = data[: place.start()] + str(random_.choice(NUMBERS)).encode() + data[place.end() :]
    return data


def _with_other_values(random_: random.Random, data: bytes) -> bytes:
    tree = yaml.load(data, Loader=yaml.CSafeLoader)
    for _ in range(random_.randint(1, 3)):
        places = list(_places(tree))
        numbers = [(parent, key) for parent, key in places if isinstance(parent[key], int | float)]
        if numbers and random_.random() < 0.5:
            # Of a list any, and not each: most numbers stand in lists.
            parent, key = random_.choice(
                list({str(place[1]): place for place in random_.sample(numbers, len(numbers))}.values())
            )
            parent[key] = random_.choice(NUMBERS)
            continue
        parent, key = random_.choice(places)
        if random_.random() < 0.2:
            del parent[key]
        elif isinstance(parent, dict) and random_.random() < 0.2:
            parent[str(random_.choice(VALUES))] = parent.pop(key)
        else:
            parent[key] = copy.deepcopy(random_.choice([*VALUES, random_.choice(places)[0]]))
    return json.dumps(tree).encode()


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every value of a tree, as what holds it and the key there."""
    pairs = list(tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else [])
    for key, value in pairs:
        yield tree, key
        yield from _places(value)


def _with_other_cells(random_: random.Random, data: bytes) -> bytes:
    with contextlib.closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(data)
        table, columns = random_.choice(
            [("event", ["time", "run", "what", "reason"]), ("campaign", ["uid", "name", "plan", "target"])]
        )
        value = random_.choice(
            [candidate for candidate in VALUES if not isinstance(candidate, list | dict)] + [b"\xff\0"]
        )
        limit = random_.randint(1, 20)
        database.execute(f"UPDATE {table} SET {random_.choice(columns)} = ? WHERE rowid <= ?", (value, limit))
        if random_.random() < 0.1:
            database.execute(f"DROP TABLE {table}")
        database.commit()
        return database.serialize()


class Hang(BaseException):
    """A reader took longer than INPUT_S."""


def _hang(*_: object) -> None:
    raise Hang


def feed(name: str, files: Files, folder: Path) -> None:
    """Give damaged files to a reader. Whatever is no error of ours goes through, and so does too much memory."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for file, data in files.items():
        (folder / file).write_bytes(data)
    READERS[name].seal(folder)
    signal.alarm(INPUT_S)
    try:
        READERS[name].read(folder)
    except (UsageError, InfrastructureError) as error:
        str(error).encode()
    finally:
        signal.alarm(0)
    assert own_peak_mib() < MEMORY_MIB, f"{own_peak_mib():.0f} MiB"


def fuzz(rounds: Iterator[int], seed: int, names: list[str], failures: Path | None = None) -> int:
    """Feed damaged files to readers; return how many. A round has one input for the costliest reader, more for others.

    What goes wrong is raised. With a folder for `failures`, its input is kept there instead, and the fuzz goes on.
    """
    count = 0
    signal.signal(signal.SIGALRM, _hang)
    most = max(reader.cost for reader in READERS.values())
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "input"
        places = (
            (round_, name, number)
            for round_ in rounds
            for name in names
            for number in range(most // READERS[name].cost)
        )
        for round_, name, number in places:
            # An input depends on its own place only, not on the readers before it.
            place = f"seed {seed}, round {round_}, reader {name}, input {number}"
            random_ = random.Random(place)
            files = dict(random_.choice(READERS[name].seeds))
            file = random_.choice(sorted(files))
            files[file] = damaged(random_, file, files[file])
            count += 1
            try:
                feed(name, files, folder)
            except (Exception, Hang) as error:
                error.add_note(f"{place}: {file}: {files[file][:2000]!r}")
                if failures is None:
                    raise
                kept = failures / re.sub(r"\W+", "-", place)
                shutil.copytree(folder, kept)
                (kept / "traceback").write_text("".join(traceback.format_exception(error)))
                print(f"{kept}: {error!r}"[:300], flush=True)
    return count


def rounds_until(end: float) -> Iterator[int]:
    """Numbers from 0 on, until that time of the monotonic clock."""
    return itertools.takewhile(lambda _: time.monotonic() < end, itertools.count())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rounds", type=int, metavar="N", help="so many rounds, however long they take")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(READERS), default=list(READERS), metavar="READER")
    parser.add_argument("--failures", type=Path, metavar="FOLDER", help="keep the inputs that fail there, and go on")
    arguments = parser.parse_args()
    rounds = (
        rounds_until(time.monotonic() + arguments.seconds) if not arguments.rounds else iter(range(arguments.rounds))
    )
    print(f"{fuzz(rounds, arguments.seed, arguments.only, arguments.failures)} inputs")
