"""The proof of the verdict on machines that are drawn at random: how often the gate says what is false.

A seed draws a machine: none, one, two or three hazards of `drawn.hazards`, their sizes, how it is measured, and what
its user does. Its files are written as the runner leaves them, and ``rtrun gate`` is asked, as a function in this
process. The truth is computed from how the machine was drawn, by nothing of the project.

    export PYTHONPATH=runner:tests
    python tests/coverage/machines.py --hours 8              # goes on after a stop; at the end writes docs/coverage.md
    python tests/coverage/machines.py --hours 0              # writes what earlier calls have examined
    python tests/coverage/machines.py --seed 4711            # one machine again: what it is, and the answers
    python tests/coverage/machines.py --hours 0.1 --only climb

Who writes here reads neither how the verdict is computed nor how it was mended.
"""

import argparse
import hashlib
import itertools
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Container, Iterator
from pathlib import Path
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from drawn.hazards import HAZARDS, hazards_of
from drawn.machine import Machine
from drawn.tables import HAZARD_LEAST, PAIR_LEAST, PAIRS_SHOWN, Line, Tables, is_false
from drawn.users import User, show

from docs_table import write_rows
from rtrun.analysis import deadline

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/coverage.md"
LINES = ROOT / "build/coverage/machines.jsonl"
# Files that live for a second: in memory where that is.
SCRATCH = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
HOURS_MAX = 8.0
BEGIN = "<!-- machines.py writes from here -->"
PARTIAL = "**No full run has been made.**"
# Rooms that measure: no gate asks them.
_NO_PART = ("execution", "on_target", "probes")
# The truth of most machines lies at the edge, but not of all.
_OF_A_PAIR = 2 * PAIR_LEAST
# More seeds than are with the processors at a time.
_IN_WORK_MAX = 1000


def digest() -> str:
    """Of what is proven and what proves it: lines of another one tell nothing of this one."""
    drawn = [path for path in Path(__file__).parent.glob("drawn/*.py") if path.name != "tables.py"]
    rooms = [path for path in (ROOT / "runner/rtrun").iterdir() if path.name not in _NO_PART]
    judging = [path for room in rooms for path in (room.rglob("*.py") if room.is_dir() else [room])]
    sources = [*sorted(path for path in judging if path.suffix == ".py"), *sorted(drawn)]
    whole = hashlib.sha256()
    for path in sources:
        whole.update(path.read_bytes())
    return whole.hexdigest()[:12]


def examine(seed: int) -> Line:
    """Draw a machine, measure it, and ask; a line of the results."""
    began = time.monotonic()
    folder = Path(tempfile.mkdtemp(prefix="rt-tests-machine-", dir=SCRATCH))
    try:
        machine = Machine(seed)
        # No answer rests on the forecast, which takes a third of the time.
        with patch.object(deadline, "likely_further", lambda *_: None):
            answer = User(machine, folder).measure_and_ask()
    except Exception:
        # A machine that cannot be drawn or read is a defect, but not of the others.
        answer = {"status": -1, "passed": False, "refuted": False, "said": [], "error": traceback.format_exc()[-1500:]}
        return {
            "seed": seed,
            "hazards": hazards_of(seed),
            "edge": False,
            "p": 1.0,
            "truths": [1.0],
            "visible": [],
        } | answer
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {
        "seed": seed,
        "hazards": machine.hazards,
        "edge": machine.is_edge,
        "p": machine.plan.probability,
        "truths": machine.truths_after(answer["runs"]),
        "visible": seen_in_files(machine, answer["failed"]),
        **answer,
        "s": round(time.monotonic() - began, 3),
    }


def seen_in_files(machine: Machine, failed: int) -> list[str]:
    """The hazards that stand in the files; those of failures where at least one of its attempts failed."""
    return [name for name in machine.visible() if failed or "failing" not in HAZARDS[name].slots]


def read_lines(path: Path, state: str) -> list[Line]:
    """The results of this state of the code; a line that was cut off is none."""
    lines = []
    for text in path.read_text().splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except ValueError:
            continue
        if line.get("digest") == state:
            lines.append(line)
    return lines


def run(seeds: Iterator[int], until: float, path: Path, state: str) -> None:
    """Examine machines on all processors until the time is over; each line is on the disk when it is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    waiting = itertools.takewhile(lambda _: time.monotonic() < until, seeds)
    if path.exists() and not path.read_bytes().endswith(b"\n"):
        with path.open("a") as out:
            out.write("\n")  # after a line that was cut off
    with path.open("a") as out, multiprocessing.Pool(min(2, os.cpu_count() or 1), maxtasksperchild=2000) as pool:
        for line in pool.imap_unordered(examine, _fed(waiting), chunksize=4):
            out.write(json.dumps(line | {"digest": state}) + "\n")
            out.flush()
            _Fed.left -= 1


def wanted(done: Container[int], only: str | None, tables: Callable[[int], Tables]) -> Iterator[int]:
    """The seeds that are to be examined: all until each hazard has its machines, then those of the worst pairs.

    `tables` gives those of the seeds below a number. Which pairs are the worst is up to seeds that were examined long
    before, so that a run that goes on chooses the same.
    """
    seeds, seed = itertools.count(), 0
    counts: Counter[str] = Counter()
    of_pairs: Counter[tuple[str, ...]] = Counter()
    while min(counts[name] for name in ([only] if only else HAZARDS)) < HAZARD_LEAST:
        seed = next(seeds)
        names = hazards_of(seed)
        if only and only not in names:
            continue
        counts.update(names)
        of_pairs[names] += 1
        if seed not in done:
            yield seed
    worst = set() if only else tables(seed - _IN_WORK_MAX).worst_pairs()
    while any(of_pairs[pair] < _OF_A_PAIR for pair in worst):
        seed = next(seeds)
        pair = hazards_of(seed)
        if pair in worst and of_pairs[pair] < _OF_A_PAIR:
            of_pairs[pair] += 1
            if seed not in done:
                yield seed


class _Fed:
    """How many seeds are with the pool: it takes all that it can get, and the time would be over for none."""

    left = 0


def _fed(seeds: Iterator[int]) -> Iterator[int]:
    for seed in seeds:
        while _Fed.left > 64:
            time.sleep(0.01)
        _Fed.left += 1
        yield seed


def print_machine(seed: int) -> int:
    """Draw one machine again, print what it is and the answers. 1 where one is false."""
    folder = Path(tempfile.mkdtemp(prefix="rt-tests-machine-", dir=SCRATCH))
    try:
        machine = Machine(seed)
        answer = User(machine, folder).measure_and_ask()
        show(machine, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    plan = machine.plan
    loops = [slot.loops for slot in machine.slots]
    print(f"seed {seed}: {', '.join(machine.names)}")
    print(f"  {plan}")
    print(f"  {sum(loops)} loops, {min(loops)} to {max(loops)} a run; asked for: below {plan.probability:g}")
    print(f"  truth: {' or '.join(f'{truth:.4g}' for truth in machine.truths)}, of: {machine.asked_about}")
    print(f"  seen in the files: {', '.join(seen_in_files(machine, answer['failed'])) or 'nothing'}")
    print(f"  gate: {answer}")
    line = {"truths": machine.truths, "p": plan.probability}
    wrong = [name for name in ("passed", "refuted") if answer[name] and is_false(line, name)]
    print(f"  {'FALSE: ' + ', '.join(wrong) if wrong else 'not false'}")
    return 1 if wrong else 0


def written(tables: Tables, text: str) -> str:
    """Write the tables into their page; a partial run replaces no full one. Return what was written."""
    lacking = tables.lacking()
    if lacking and PARTIAL not in PAGE.read_text():
        return f"{PAGE.name} keeps the tables of a full run; this one is partial: {'; '.join(lacking[:3])}"
    hours = sum(line.get("s", 0) for line in tables.lines) / 3600
    seeds = [line["seed"] for line in tables.lines]
    rests_on = f"{len(seeds)} machines (seeds {min(seeds)} to {max(seeds)}), {hours:.1f} hours of one processor"
    if lacking:
        head = (
            f"{PARTIAL} These tables rest on {rests_on}.\n"
            f"A full run has {HAZARD_LEAST} of each hazard, and {PAIRS_SHOWN} pairs with {PAIR_LEAST} at the edge. "
            f"This one lacks: {'; '.join(lacking[:3])}{' and more' if len(lacking) > 3 else ''}."
        )
    else:
        head = f"A full run: {rests_on}."
    write_rows(PAGE, BEGIN, f"{head}\n", [text])
    return f"{PAGE.name} has the tables of a {'partial' if lacking else 'full'} run"


def main() -> int:
    """Exit status: 0 where no row fails, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--hours",
        type=float,
        default=HOURS_MAX,
        help=f"how long at most, with what was done before on top [{HOURS_MAX:g}]",
    )
    parser.add_argument("--seed", type=int, help="draw this one machine again, and print it")
    parser.add_argument("--only", choices=list(HAZARDS), help="machines with this hazard alone or with others")
    parser.add_argument(
        "--lines", type=Path, default=LINES, help="the file of results, a line each, that is gone on with"
    )
    parser.add_argument("--least", type=int, default=None, help="show pairs with so many machines at the edge [400]")
    args = parser.parse_args()
    if args.seed is not None:
        return print_machine(args.seed)
    state = digest()
    done = {line["seed"] for line in read_lines(args.lines, state)}

    def tables_below(seed: int) -> Tables:
        return Tables(line for line in read_lines(args.lines, state) if line["seed"] < seed)

    seeds = wanted(done, args.only, tables_below)
    run(seeds, time.monotonic() + args.hours * 3600, args.lines, state)
    tables = Tables(line for line in read_lines(args.lines, state) if not args.only or args.only in line["hazards"])
    least = {} if args.least is None else {"least": args.least}
    text = tables.text(**least)
    print(text)
    broken = [line for line in tables.lines if line.get("error")]
    for line in broken[:5]:
        print(f"seed {line['seed']}: exit status {line['status']}: {line['error']}", file=sys.stderr)
    failures = tables.failures(**least)
    print(
        f"{len(tables.lines)} machines, {len(broken)} without an answer; "
        f"{len(failures)} rows fail: {'; '.join(failures)}"
    )
    if tables.lines and not args.only:
        print(written(tables, text))
    return 1 if failures or any(line["status"] == -1 for line in broken) else 0


if __name__ == "__main__":
    sys.exit(main())
