"""Plant culprits and see whether `rtrun why` names them; the tables go into docs/causes.md.

PYTHONPATH=runner:tests .venv/bin/python tests/why/planted.py [--place here] [--trials 10] [--only lock,equal]

Here root, tracefs, a second CPU and gcc are needed; for the board what `rtgen board build` needs. A trial is a slice of
a run, of some seconds. A slice of whose outliers no trace could be read is none, and another one is made: it does not
tell what would have been named. The table counts these slices.
"""

import argparse
import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path

from places import Place, beside, board, preloaded, this_machine

from docs_table import write_rows
from rtrun.causes.parts import Kind
from rtrun.causes.ranking import Ranking, rank
from rtrun.report import causes
from rtrun.results.reading import find_source

DOCS = Path(__file__).parents[2] / "docs" / "causes.md"
BEGIN = "<!-- make test-why writes {} from here -->"
HEAD = """\
| planted | must come first | came first | trials | traced outliers | slices without trace | otherwise |
|---|---|---:|---:|---:|---:|---|"""
AT_LEAST = 0.9
# With fewer than these a row is printed and not written.
TRIALS = 10
CAMPAIGN = """\
schema: 1
name: planted
runs:
  - {{suite: cyclic_timer_tests, frequency_hz: {frequency_hz}, repetitions: {repetitions}, policy: RR,
     priority: {priority}, cpu: "{cpu}", trace: {{above: {threshold_us}us}}, repeats: {runs}}}
exclude:
  - {{trace: "off"}}
"""
PLACES: dict[str, Callable[[Path], AbstractContextManager[Place]]] = {
    "here": this_machine,
    "rt": partial(board, "rt"),
    "standard": partial(board, "standard"),
}


@dataclass(frozen=True, slots=True)
class Plant:
    """A culprit: a program of plants.py, or a value of PLANT for planted.c, and the kind and name that must be said."""

    name: str
    about: str
    kind: Kind | None
    who: str = ""
    places: tuple[str, ...] = ("here", "rt")
    preloaded: bool = False
    cpu: int = 1
    priority: int = 95
    threshold_percent: int = 100
    """Of the threshold of the place, where an event does not last as long as another's."""


PLANTS = (
    Plant("higher", "thread at priority 98", Kind.HIGHER, "planted_hog", ("here", "rt", "standard")),
    Plant("equal", "thread at the same priority", Kind.EQUAL, "planted_equal"),
    Plant("softirq", "a packet for some thousand sockets", Kind.SOFTIRQ, "NET_RX", ("here",)),
    Plant("throttling", "real-time thread that never sleeps", Kind.THROTTLED, "planted_fair"),
    Plant("stopped", "the program is stopped (SIGSTOP)", Kind.STOPPED, "planted_stopper", ("here",)),
    Plant("frozen", "the program's control group is frozen", Kind.FROZEN, "planted_freezer", ("here",)),
    Plant("lock", "thread that keeps a mutex", Kind.LOCK, "planted_lock", preloaded=True),
    Plant(
        "faults", "8192 page faults in the callback", Kind.FAULT, "cyclic_timer_te", places=("here",), preloaded=True
    ),
    Plant(
        "stop_machine",
        "stop_machine, by the function tracer",
        Kind.HIGHER,
        "migration/1",
        ("rt",),
        threshold_percent=35,
    ),
    Plant("printk", "printk to a serial console", Kind.CONSOLE, "planted_printk", places=("standard",)),
    Plant("storm", "packets from outside", Kind.SOFTIRQ, "NET_RX", places=("rt", "standard"), cpu=0, priority=40),
    Plant("nothing", "nothing", None, places=("here", "rt", "standard")),
)


def slices(plant: Plant, count: int, place: Place, folder: Path) -> Iterator[Ranking]:
    """The ranking of each slice of the runs beside a plant: `count`, then more, run by run, at most as many again."""
    built = preloaded(place, plant.name, folder) if plant.preloaded else place.built
    (folder / "target.yml").write_text(f"schema: 1\nname: place\nsuites: {built}\n{place.target}")
    is_beside = not plant.preloaded and plant.kind is not None
    at_first = -(-count // place.slices)
    with beside(place, plant.name, plant.cpu) if is_beside else contextlib.nullcontext():
        for number, runs_wanted in enumerate([at_first] + at_first * [1]):
            results = folder / f"results-{plant.name}-{number}"
            for run in measured(plant, runs_wanted, place, folder, results):
                yield from rankings(run, place)


def measured(plant: Plant, runs_wanted: int, place: Place, folder: Path, results: Path) -> list[Path]:
    """The runs of a campaign beside a plant."""
    campaign = CAMPAIGN.format(
        frequency_hz=place.frequency_hz,
        repetitions=place.repetitions * place.slices,
        threshold_us=place.threshold_us * plant.threshold_percent // 100,
        cpu=plant.cpu,
        priority=plant.priority,
        runs=runs_wanted,
    )
    (folder / "campaign.yml").write_text(campaign)
    argv = [sys.executable, "-m", "rtrun.cli", "run", folder / "campaign.yml", "--target", folder / "target.yml"]
    output = run_program([*argv, "--results", results])
    runs = sorted(path.parent for path in results.glob("*/run.json"))
    if len(runs) != runs_wanted:
        raise RuntimeError(f"{len(runs)} of {runs_wanted} runs\n{output}")
    return runs


def rankings(run: Path, place: Place) -> Iterator[Ranking]:
    """The ranking of each slice of a run."""
    explained, refused = causes.explain_source(find_source(run))
    if refused:
        raise RuntimeError("\n".join(refused))
    for first in range(0, place.slices * place.repetitions, place.repetitions):
        yield rank(one for one in explained if first <= one.outlier.index < first + place.repetitions)


def run_program(argv: list[str | Path]) -> str:
    """What a program prints. It is interrupted when we are, and may then take down what it started."""
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as runner:
        try:
            return runner.communicate()[0]
        except BaseException:
            runner.send_signal(signal.SIGINT)
            runner.communicate()
            raise


def line(plant: Plant, count: int, place: Place, folder: Path) -> tuple[str, bool]:
    """The row of a plant, and whether it was named, or nothing, often enough."""
    hits, outliers, trials, untraced, others = 0, 0, 0, 0, []
    with contextlib.closing(slices(plant, count, place, folder)) as made:
        for ranking in made:
            if plant.kind is not None and not ranking.outliers:
                untraced += 1
                continue
            trials += 1
            outliers += ranking.outliers
            # Beside a plant it must be the first of the ranking; beside none, nobody may be named.
            first = ranking.named if plant.kind is None else next(iter(ranking.culprits), None)
            if (first and (first.kind, first.name)) == (plant.kind and (plant.kind, plant.who)):
                hits += 1
            else:
                others.append(causes.culprit_name(first) if first else causes.answer(ranking))
            if trials == count:
                break
    expected = f"{plant.kind} `{plant.who}`" if plant.kind else "nobody"
    otherwise = "; ".join(f"{others.count(one)} x {one}" for one in dict.fromkeys(others))
    row = f"| {plant.about} | {expected} | {hits} | {trials} | {outliers} | {untraced} | {otherwise} |"
    return row, hits >= AT_LEAST * count


def main() -> int:
    """Plant, print, write. Exit 1 when a culprit is named too rarely."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--place", choices=PLACES, default="here", help="this machine, or a kernel of the board [here]")
    parser.add_argument("--trials", type=int, default=TRIALS, help="runs beside each culprit [10]")
    parser.add_argument("--only", default="", help="the culprits of these names, as lock,equal")
    parser.add_argument("--keep", type=Path, help="the folder for results, which stay")
    args = parser.parse_args()
    plants = [one for one in PLANTS if args.place in one.places and (not args.only or one.name in args.only.split(","))]
    # Whatever ends this program, no plant stays behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    start_s, failed = time.monotonic(), 0
    with contextlib.ExitStack() as stack:
        folder = args.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(exist_ok=True)
        place = stack.enter_context(PLACES[args.place](folder))
        for plant in plants:
            row, holds = line(plant, args.trials, place, folder)
            failed += not holds
            print(f"{row} {time.monotonic() - start_s:.0f} s", flush=True)
            if args.trials >= TRIALS:
                head = f"{place.about}, latest row of {date.today()}:\n\n{HEAD}"
                write_rows(DOCS, BEGIN.format(args.place), head, [row], [plant.about for plant in PLANTS])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
