"""Plant culprits on this machine and see whether `rtrun why` names them; the table goes into docs/causes.md.

.venv/bin/python tests/why/planted.py [--trials 10] [--only lock]

Root, tracefs, a second CPU and gcc are needed. Each trial is a campaign of some seconds.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from ports import free_port
from rtgen import suites
from rtrun.causes.cut import Kind
from rtrun.causes.ranking import Ranking
from rtrun.report import causes
from rtrun.results.reading import find_source

HERE = Path(__file__).parent
DOCS = HERE.parents[1] / "docs" / "causes.md"
BEGIN, END = "<!-- make test-why writes from here -->", "<!-- to here -->"
HEAD = """\
| planted | must come first | came first | trials | traced outliers | otherwise |
|---|---|---:|---:|---:|---|"""
AT_LEAST = 0.9
PROGRAM = Path("lib/cyclic_timer_tests/cyclic_timer_tests")
CAMPAIGN = """\
schema: 1
name: planted
runs:
  - {suite: cyclic_timer_tests, frequency_hz: 500, repetitions: 3000, policy: RR, cpu: "1", trace: {above: 1ms}}
exclude:
  - {trace: "off"}
"""


@dataclass(frozen=True, slots=True)
class Plant:
    """A culprit: a program of plants.py, or a value of PLANT for planted.c, and the kind and name that must be said."""

    name: str
    about: str
    kind: Kind | None
    who: str = ""
    preloaded: bool = False


PLANTS = (
    Plant("higher", "thread at priority 98, busy for 3 ms", Kind.HIGHER, "planted_hog"),
    Plant("equal", "thread at the same priority, busy for 3 ms", Kind.EQUAL, "planted_equal"),
    Plant("softirq", "broadcasts to 3000 sockets", Kind.SOFTIRQ, "NET_RX"),
    Plant("throttling", "real-time thread that never sleeps", Kind.THROTTLED, "planted_fair"),
    Plant("lock", "thread that keeps a mutex for 3 ms", Kind.LOCK, "planted_lock", preloaded=True),
    Plant("faults", "2048 page faults in the callback", Kind.FAULT, "cyclic_timer_te", preloaded=True),
    Plant("nothing", "nothing", None),
)


def prepare(folder: Path) -> tuple[Path, Path]:
    """The suites, and a copy of them whose program is started with planted.c."""
    built = suites.build("host", folder)
    library = folder / "planted.so"
    subprocess.run(
        ["gcc", "-O2", "-shared", "-fPIC", "-o", library, HERE / "planted.c", "-ldl", "-lpthread"], check=True
    )
    wrapped = folder / "wrapped"
    shutil.copytree(built, wrapped)
    (wrapped / PROGRAM).unlink()
    (wrapped / PROGRAM).write_text(f'#!/bin/sh\n. {folder}/plant\nLD_PRELOAD={library} exec {built / PROGRAM} "$@"\n')
    (wrapped / PROGRAM).chmod(0o755)
    return built, wrapped


def trial(plant: Plant, folder: Path, built: Path, wrapped: Path) -> Ranking:
    """The ranking of a campaign beside the plant."""
    (folder / "plant").write_text(f"export PLANT={plant.name}\n")
    (folder / "campaign.yml").write_text(CAMPAIGN)
    (folder / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {wrapped if plant.preloaded else built}\n"
        f"work_dir: {folder / 'work'}\nros_master_port: {free_port()}\n"
    )
    results = folder / "results"
    shutil.rmtree(results, ignore_errors=True)
    beside = None
    if not plant.preloaded and plant.kind is not None:
        beside = subprocess.Popen([sys.executable, HERE / "plants.py", plant.name], start_new_session=True)
    try:
        argv = [sys.executable, "-m", "rtrun.cli", "run", folder / "campaign.yml", "--target", folder / "target.yml"]
        done = subprocess.run([*argv, "--results", results], capture_output=True, text=True, check=False)
    finally:
        if beside is not None:
            os.killpg(beside.pid, signal.SIGKILL)
            beside.wait()
    try:
        ranking, _, refused = causes.ranked(find_source(results))
    except Exception:
        print(done.stdout, done.stderr, file=sys.stderr)
        raise
    if refused:
        raise RuntimeError("\n".join(refused))
    return ranking


def line(plant: Plant, trials: int, folder: Path, built: Path, wrapped: Path) -> tuple[str, bool]:
    """The row of a plant, and whether it was named, or nothing, often enough."""
    hits, outliers, others = 0, 0, []
    for _ in range(trials):
        ranking = trial(plant, folder, built, wrapped)
        outliers += ranking.outliers
        # Beside a plant it must be the first of the ranking; beside none, nobody may be named.
        first = ranking.named if plant.kind is None else next(iter(ranking.culprits), None)
        if (first and (first.kind, first.name)) == (plant.kind and (plant.kind, plant.who)):
            hits += 1
        else:
            others.append(causes.culprit_name(first) if first else "nobody")
    expected = f"{plant.kind} `{plant.who}`" if plant.kind else "nobody"
    otherwise = "; ".join(f"{others.count(one)} x {one}" for one in dict.fromkeys(others))
    row = f"| {plant.about} | {expected} | {hits} | {trials} | {outliers} | {otherwise} |"
    return row, hits >= AT_LEAST * trials


def main() -> int:
    """Plant, print, write. Exit 1 when a culprit is named too rarely."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=10, help="campaigns for each culprit [10]")
    parser.add_argument("--only", default="", help="the culprit of this name, printed and not written")
    args = parser.parse_args()
    start, rows, failed = time.monotonic(), [], 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        built, wrapped = prepare(folder)
        for plant in PLANTS:
            if args.only in ("", plant.name):
                row, holds = line(plant, args.trials, folder, built, wrapped)
                failed += not holds
                rows.append(row)
                print(row, flush=True)
    if not args.only:
        before, _, rest = DOCS.read_text().partition(BEGIN)
        minutes = (time.monotonic() - start) / 60
        made = f"Made in {minutes:.0f} minutes on Linux {os.uname().release}, {os.cpu_count()} CPUs."
        DOCS.write_text("\n".join([before + BEGIN, made, "", HEAD, *rows, END]) + rest.partition(END)[2])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
