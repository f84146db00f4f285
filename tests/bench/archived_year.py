"""Archives of two billion measurements and of 10 000 runs, and how long `rtrun history` takes over them.

Of the first, four scenarios are measured once a day for a year. What the runs are made of is real: wake-ups of this
machine, measured at the start. A day has the counts of that histogram, Poisson for 1.37 million measurements, in steps
of 16 ns.
"""

import json
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "rtrun"))
from archive.archived import write_course

from rtrun.analysis.histogram import Histogram, from_samples
from rtrun.archive.store import make_archive, write_file
from rtrun.archive.tables import Origin, as_parquet, file_of, histogram_table, run_table
from rtrun.kinds.values import Int64s
from rtrun.results.record import RunRecord, RunStatus, TargetFacts
from rtrun.results.series import Header, HistogramSeries
from rtrun.targets.inspection.platform import Platform

MEASUREMENTS = 2_000_000_000
FREQUENCIES_HZ = (100, 250, 500, 1000)
DAYS = 365
BOARDS = 30
STEP_NS = 16
_MEASURED = 20_000
_SPREAD_NS = 400  # the values of a run, each spread over so many ns, stand for those of many runs


def wake_ups(count: int) -> Int64s:
    """How late this thread wakes from so many sleeps of 100 us, in ns."""
    late = np.empty(count, np.int64)
    for k in range(count):
        start = time.monotonic_ns()
        time.sleep(1e-4)
        late[k] = time.monotonic_ns() - start - 100_000
    return late


def write_year(archive: Path, rng: np.random.Generator) -> int:
    """Write the archive; returns how many bins it has."""
    store = make_archive(str(archive))
    measured = np.repeat(wake_ups(_MEASURED), 50)
    basis = from_samples(measured + rng.integers(-_SPREAD_NS, _SPREAD_NS, measured.size), STEP_NS)
    mean_counts = basis.counts * (MEASUREMENTS / DAYS / len(FREQUENCIES_HZ) / measured.size)
    bins = 0
    for day in range(DAYS):
        for frequency_hz in FREQUENCIES_HZ:
            counts = rng.poisson(mean_counts)
            key = f"{day:032d}{frequency_hz:032d}"
            record = _record(
                f"{day:03d}-cyclic-{frequency_hz}", frequency_hz, datetime(2026, 1, 1) + timedelta(days=day)
            )
            header = Header(
                run=record.run, suite=record.suite, output="o", series="jitter", parameters=record.parameters
            )
            histogram = Histogram(values_ns=basis.values_ns[counts > 0], counts=counts[counts > 0], bin_ns=STEP_NS)
            series = HistogramSeries(header=header, histogram=histogram, top=(), lowest=(), absent_count=0)
            write_file(store, file_of("histograms", key), as_parquet(histogram_table(key, [series])))
            write_file(store, file_of("runs", key), as_parquet(run_table(key, record, Origin())))
            bins += histogram.values_ns.size
    return bins


def _record(run: str, frequency_hz: int, start: datetime) -> RunRecord:
    return RunRecord(
        schema=2,
        run=run,
        campaign="year",
        suite="cyclic_timer_tests",
        parameters={"policy": "FIFO", "frequency_hz": frequency_hz},
        platform=Platform.VIRTUAL,
        platform_evidence="bench",
        status=RunStatus.OK,
        reason=None,
        start_time=f"{start.isoformat()}Z",
        end_time=f"{start.isoformat()}Z",
        programs=[],
        outputs=["o"],
        target=TargetFacts(name="bench", kernel_release="6.1.0-rt", boot_id=f"boot {start.isoformat()}"),
        files={},
    )


def history() -> list[tuple[str, float, float, str]]:
    """`rtrun history` over the year, whole and by kernel; every measurement is in the answer."""
    rtrun = [sys.executable, "-m", "rtrun.cli"]
    checks = []
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "archive"
        bins = write_year(archive, np.random.default_rng(20140715))
        size = sum(path.stat().st_size for path in archive.rglob("*.parquet"))
        for by in ("day", "kernel"):
            start = time.perf_counter()
            command = [*rtrun, "history", str(archive), "--by", by, "--json"]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            taken = time.perf_counter() - start
            points = json.loads(done.stdout)["points"]
            total = sum(point["n"] for point in points)
            assert abs(total - MEASUREMENTS) < 1e-3 * MEASUREMENTS, total
            assert len(points) == len(FREQUENCIES_HZ) * (DAYS if by == "day" else 1)
            name = f"rtrun history --by {by} over {total / 1e9:.2f} billion measurements"
            checks.append((f"{name} ({bins / 1e6:.1f} million bins, {size / 1e6:.0f} MB)", taken, 5.0, "s"))
    return checks


def lab() -> list[tuple[str, float, float, str]]:
    """`rtrun history` over 10 000 runs of thirty boards that were put together, and over one day of one board."""
    rtrun = [sys.executable, "-m", "rtrun.cli"]
    checks = []
    with tempfile.TemporaryDirectory() as folder, mock.patch("os.fsync"):
        archive = Path(folder) / "archive"
        for board in range(BOARDS):
            write_course(archive, [100.0] * 167, machine=f"board-{board:02}", seed=board + 1)
        single = write_course(Path(folder) / "one", [100.0])
        for words in ([], ["--grace", "1ns"]):
            subprocess.run([*rtrun, "archive", "compact", str(archive), *words], check=True, capture_output=True)
        for asked, by, limit_s in ((archive, "day", 3.0), (archive, "kernel", 3.0), (single, "day", 1.0)):
            start = time.perf_counter()
            command = [*rtrun, "history", str(asked), "--by", by, "--json"]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            taken = time.perf_counter() - start
            runs = sum(len(point["run_keys"]) for point in json.loads(done.stdout)["points"])
            assert runs == (2 if asked is single else 334 * BOARDS), runs
            checks.append((f"rtrun history --by {by} of {runs} runs", taken, limit_s, "s"))
    return checks


def main() -> int:
    """Print every time; 1 when one is beyond its limit."""
    checks = [*history(), *lab()]
    for name, value, limit, unit in checks:
        print(f"{name}: {value:.3g} {unit} (limit {limit:g} {unit})")
    return int(any(value > limit for _, value, limit, _ in checks))


if __name__ == "__main__":
    sys.exit(main())
