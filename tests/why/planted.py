"""Plant culprits and see whether `rtrun why` names them; the tables go into docs/causes.md.

PYTHONPATH=runner:tests .venv/bin/python tests/why/planted.py [--place here] [--trials 10] [--only lock,equal]

Here root, tracefs, a second CPU and gcc are needed; for the board what `rtgen board build` needs. A trial is a slice of
a run, of some seconds. A slice of whose outliers no trace could be read is none, and another one is made: it does not
tell what would have been named. The table counts these slices.
"""

import argparse
import contextlib
import re
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

import plants
from places import Place, beside, board, preloaded, this_machine

from docs_table import write_rows
from rtrun.causes.outliers import Explained, Outlier
from rtrun.causes.parts import Kind
from rtrun.causes.ranking import Culprit, Ranking, rank
from rtrun.report import causes
from rtrun.results.reading import find_source
from rtrun.targets.address import ThisMachine

DOCS = Path(__file__).parents[2] / "docs" / "causes.md"
BEGIN = "<!-- make test-why writes {} from here -->"
HEAD = """\
| planted | must be named | in | of outliers | others | first in | of trials | slices without trace | otherwise |
|---|---|---:|---:|---:|---:|---:|---:|---|"""
AT_LEAST = 0.9
# An event that begins late, as a process that is started first, begins within this time.
BEGINS_WITHIN_NS = 50_000_000
# With fewer than these a row is printed and not written.
TRIALS = 10
CAMPAIGN = """\
schema: 1
name: planted
runs:
  - {{suite: cyclic_timer_tests, frequency_hz: {frequency_hz}, repetitions: {repetitions}, policy: {policy},
     {priority}cpu: "{cpu}", trace: {{above: {threshold_us}us}}, trace_of: {series}, repeats: {runs}}}
exclude:
  - {{trace: "off"}}
"""
ENTER = 'group=$1; shift; echo $$ >"$group/cgroup.procs" && exec "$@"'
PLACES: dict[str, Callable[[Path], AbstractContextManager[Place]]] = {
    "here": this_machine,
    "rt": partial(board, "rt"),
    "standard": partial(board, "standard"),
}


@dataclass(frozen=True, slots=True)
class Plant:
    """A culprit: a program of plants.py, or a value of PLANT for planted.c, and the kind and name that must be said.

    `who` is a regular expression. `other` is a second culprit, which is there at once.
    """

    name: str
    about: str
    kind: Kind | None
    who: str = ""
    other: tuple[Kind, str] | None = None
    places: tuple[str, ...] = ("here", "rt")
    preloaded: bool = False
    cpu: int = 1
    policy: str = "RR"
    priority: int | None = 95
    group: str = ""
    """The control group that the run is started in, which the plant makes."""
    event_lengths: float | None = 1
    """How long an event is in lengths of the place, where events come at multiples of a time: plants.pause."""
    threshold_percent: int = 100
    """Of the threshold of the place, where an event does not last as long as another's."""

    @property
    def expected(self) -> list[tuple[Kind, str]]:
        return [] if self.kind is None else [(self.kind, self.who), *filter(None, [self.other])]

    def is_named(self, culprit: Culprit | None) -> bool:
        """Whether what was planted is reported, or nothing beside nothing."""
        if culprit is None:
            return self.kind is None
        return any(culprit.kind is kind and re.fullmatch(who, culprit.name) for kind, who in self.expected)


GROUP_FOLDER = "/sys/fs/cgroup/cpu/planted_group"
PLANTS = (
    Plant("higher", "thread at priority 98", Kind.HIGHER, "planted_hog", places=("here", "rt", "standard")),
    Plant("equal", "thread at the same priority", Kind.EQUAL, "planted_equal"),
    Plant("softirq", "a packet for some thousand sockets", Kind.SOFTIRQ, "NET_RX", places=("here",)),
    Plant("throttling", "real-time thread that never sleeps", Kind.THROTTLED, ".*", event_lengths=None),
    Plant("deadline", "threads at SCHED_DEADLINE, on any CPU", Kind.DEADLINE, "planted_dl", places=("here",)),
    Plant(
        "processes",
        "FIFO 99, a process of its own each time",
        Kind.HIGHER,
        r"planted_job\d+",
        places=("here",),
    ),
    Plant("long", "two threads at 98 that began before the trace", Kind.HIGHER, "planted_long", places=("here",)),
    Plant("longer", "the same, of which the trace holds a twentieth", Kind.UNEXPLAINED, ".*", places=("here",)),
    Plant(
        "own",
        "thread of the program at priority 97",
        Kind.OTHER_THREAD,
        "planted_own",
        places=("here",),
        preloaded=True,
    ),
    Plant(
        "several",
        "thread at priority 98, and SIGSTOP",
        Kind.HIGHER,
        "planted_hog",
        (Kind.STOPPED, "planted_stopper"),
        places=("here",),
    ),
    Plant("stopped", "the program is stopped (SIGSTOP)", Kind.STOPPED, "planted_stopper", places=("here",)),
    Plant("stopped_by_others", "SIGSTOP and SIGCONT by two processes", Kind.STOPPED, "planted_stop", places=("here",)),
    Plant("frozen", "the program's control group is frozen", Kind.FROZEN, "planted_freezer", places=("here",)),
    Plant("frozen_v2", "the same, version 2", Kind.FROZEN, "planted_freezer", places=("here",)),
    Plant(
        "rt_group",
        "cpu.rt_runtime_us of the program's control group",
        Kind.GROUP,
        "/planted_group .*",
        places=("here",),
        group=GROUP_FOLDER,
        event_lengths=10,
    ),
    Plant(
        "quota",
        "CFS quota, the program at OTHER",
        Kind.GROUP,
        "/planted_group .*",
        places=("here",),
        policy="0",
        priority=None,
        group=GROUP_FOLDER,
        threshold_percent=500,
        event_lengths=10,
    ),
    Plant(
        "io",
        "writers, readers, files, memory",
        Kind.NOT_PREEMPTED,
        # What they leave to be written, the kernel's workers that belong to no CPU write.
        r"planted_io|kworker/u\d+:\d+",
        other=(Kind.TIMER_LATE, "planted_io"),
        places=("here",),
        event_lengths=None,
        threshold_percent=20,
    ),
    Plant(
        "fsync",
        "log lines with fsync in the callback, beside processes that do so",
        Kind.BLOCKED,
        ".*",
        places=("here",),
        preloaded=True,
    ),
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


def slices(plant: Plant, count: int, place: Place, folder: Path) -> Iterator[list[Explained]]:
    """The outliers of each slice of the runs beside a plant: `count`, then more, run by run, at most as many again."""
    built = preloaded(place, plant.name, plant.cpu, folder) if plant.preloaded else place.built
    (folder / "target.yml").write_text(f"schema: 1\nname: place\nsuites: {built}\n{place.target}")
    is_beside = plant.name in plants.PLANTS
    at_first = -(-count // place.slices)
    with beside(place, plant.name, plant.cpu) if is_beside else contextlib.nullcontext():
        for number, runs_wanted in enumerate([at_first] + at_first * [1]):
            results = folder / f"results-{plant.name}-{number}"
            for run in measured(plant, runs_wanted, place, folder, results):
                yield from explained_in(run, place)


def measured(plant: Plant, runs_wanted: int, place: Place, folder: Path, results: Path) -> list[Path]:
    """The runs of a campaign beside a plant."""
    campaign = CAMPAIGN.format(
        frequency_hz=place.frequency_hz,
        repetitions=place.repetitions * place.slices,
        threshold_us=place.threshold_us * plant.threshold_percent // 100,
        cpu=plant.cpu,
        policy=plant.policy,
        # What is preloaded is in the callback: that is late within, and has begun in time.
        series="jitter" if plant.preloaded else "lateness",
        priority="" if plant.priority is None else f"priority: {plant.priority}, ",
        runs=runs_wanted,
    )
    (folder / "campaign.yml").write_text(campaign)
    argv = [sys.executable, "-m", "rtrun.cli", "run", folder / "campaign.yml", "--target", folder / "target.yml"]
    enter: list[str | Path] = ["sh", "-c", ENTER, "sh", plant.group] if plant.group else []
    output = run_program([*enter, *argv, "--results", results])
    runs = sorted(path.parent for path in results.glob("*/run.json"))
    if len(runs) != runs_wanted:
        raise RuntimeError(f"{len(runs)} of {runs_wanted} runs\n{output}")
    return runs


def explained_in(run: Path, place: Place) -> Iterator[list[Explained]]:
    """The outliers of each slice of a run."""
    explained, refused = causes.ranked(find_source(run))[1:]
    if refused:
        raise RuntimeError("\n".join(refused))
    for first in range(0, place.slices * place.repetitions, place.repetitions):
        yield [found for found in explained if first <= found.outlier.index < first + place.repetitions]


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
    hits, named, outliers, beside, trials, untraced, others = 0, 0, 0, 0, 0, 0, []
    with contextlib.closing(slices(plant, count, place, folder)) as explained_slices:
        for explained in explained_slices:
            ranking = rank(explained)
            if plant.kind is not None and not ranking.outliers:
                untraced += 1
                continue
            trials += 1
            # Beside a plant it must be the first of the ranking; beside none, nobody may be named.
            hits += plant.is_named(ranking.named if plant.kind is None else ranking.culprits[0])
            during = [found for found in explained if found.parts and is_during(found.outlier, plant, place)]
            beside += ranking.outliers - len(during)
            outliers += len(during)
            for alone in (rank([found]) for found in during):
                first = main_cause(alone) if plant.kind is not None else alone.named
                # Whoever it is, several of a kind are as good as one.
                is_named = plant.is_named(first) or (plant.who == ".*" and alone.named_kind is plant.kind)
                named += is_named
                if not is_named:
                    others.append(without_ids(causes.culprit_name(first) if first else "no main cause"))
            if trials == count:
                break
    # A name a code span: an upright bar would end the cell of the table.
    names = {who: " or ".join(f"`{name}`" for name in who.split("|")) for _, who in plant.expected}
    culprits = [str(kind) if who == ".*" else f"{kind} {names[who]}" for kind, who in plant.expected]
    expected = " or ".join(culprits) or "nobody"
    otherwise = "; ".join(f"{others.count(name)} x {name}" for name in dict.fromkeys(others))
    numbers = (named, outliers, beside, hits, trials, untraced)
    row = f"| {plant.about} | {expected} | {' | '.join(map(str, numbers))} | {otherwise} |"
    # Beside nothing, single outliers have causes of their own.
    return row, hits >= AT_LEAST * count and (plant.kind is None or named >= AT_LEAST * outliers)


def is_during(outlier: Outlier, plant: Plant, place: Place) -> bool:
    """Whether a plant had an event within an outlier. Other outliers are of whatever else the machine does."""
    if plant.event_lengths is None or plant.kind is None or place.address != ThisMachine():
        return True
    offset_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC) - time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    period_ns = plants.period_ms(round(plant.event_lengths * place.length_ms)) * 1_000_000
    since_event_ns = (outlier.at_ns + offset_ns) % period_ns
    length_ns = int(plant.event_lengths * place.length_ms * 1_000_000)
    return since_event_ns <= outlier.value_ns + length_ns + BEGINS_WITHIN_NS


def main_cause(ranking: Ranking) -> Culprit | None:
    """What took more than half of the one outlier of a ranking."""
    return next((culprit for culprit in ranking.culprits if culprit.main), None)


def without_ids(text: str) -> str:
    """The same for processes of one name."""
    return re.sub(r"pid \d+(, )?", "", text).replace(" ()", "")


def main() -> int:
    """Plant, print, write. Exit 1 when a culprit is named too rarely."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--place", choices=PLACES, default="here", help="this machine, or a kernel of the board [here]")
    parser.add_argument("--trials", type=int, default=TRIALS, help="runs beside each culprit [10]")
    parser.add_argument("--only", default="", help="the culprits of these names, as lock,equal")
    parser.add_argument("--keep", type=Path, help="the folder for results, which stay")
    args = parser.parse_args()
    plants = [
        plant
        for plant in PLANTS
        if args.place in plant.places and (not args.only or plant.name in args.only.split(","))
    ]
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
