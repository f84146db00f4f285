"""Archives of many days, written without run directories: each day is a boot with two runs of one-shot timers."""

import hashlib
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from report.campaigns import oneshot_run

from rtrun.analysis.histogram import from_samples
from rtrun.archive.store import make_archive, write_file
from rtrun.archive.tables import Origin, as_parquet, file_of, histogram_table, run_table
from rtrun.results.record import Observed, RunRecord, RunStatus, TargetFacts
from rtrun.results.series import Header, HistogramSeries
from rtrun.targets.inspection.platform import Platform

START = datetime(2026, 1, 1, 10)
N = 4000
PARAMETERS: dict[str, Any] = {"policy": "RR", "repetitions": N, "timeout_us": 1000, "busy_mode": 0}


def values_of_boots(
    levels_us: Sequence[float], rng: np.random.Generator, lengths: Sequence[int] = ()
) -> list[list[np.ndarray]]:
    """Two runs for each boot: the boot differs from its level by 1 %, a run from its boot by half of that."""
    boots = [level * (1 + 0.01 * rng.normal()) for level in levels_us]
    runs = [[boot * (1 + 0.005 * rng.normal()) for _ in range(2)] for boot in boots]
    return [
        [(1000 * rng.normal(mean, 3, n)).astype(np.int64) for mean in boot]
        for boot, n in zip(runs, lengths or [N] * len(runs), strict=True)
    ]


def write_course(
    archive: Path,
    levels_us: Sequence[float],
    *,
    facts: Sequence[dict[str, Any]] = (),
    late: Sequence[int] = (),
    platform: Platform = Platform.HARDWARE,
    suite: str = "oneshot_timer_tests",
    machine: str = "board",
    parameters: Mapping[str, Any] = MappingProxyType({}),
    seed: int = 1,
    lengths: Sequence[int] = (),
    constant_ns: int | None = None,
) -> Path:
    """A day for each level, with runs of `lengths` measurements.

    `facts` has kernel, commit, packages and temperature_mc of each day, `late` how many misses. With `constant_ns` all
    values are that.
    """
    store = make_archive(str(archive))
    for day, runs in enumerate(values_of_boots(levels_us, np.random.default_rng(seed), lengths)):
        fact = facts[day] if facts else {}
        for k, values in enumerate(runs):
            if constant_ns is not None:
                values[:] = constant_ns
            values[: late[day] if late else 0] = 500_000
            start = START + timedelta(days=day, hours=k)
            temperature = fact.get("temperature_mc")
            record = RunRecord(
                schema=2,
                run=f"{k:03d}-oneshot",
                campaign="daily",
                suite=suite,
                parameters=PARAMETERS | {**parameters},
                platform=platform,
                platform_evidence="stated by the test",
                status=RunStatus.OK,
                reason=None,
                in_effect=Observed(temperature_mc=temperature and [temperature - 500, temperature]),
                start_time=f"{start.isoformat()}Z",
                end_time=f"{start.isoformat()}Z",
                programs=[],
                outputs=["o"],
                target=TargetFacts(name=machine, kernel_release=fact.get("kernel", "6.1"), boot_id=f"boot-{day}"),
                files={},
            )
            header = Header(run=record.run, suite=record.suite, output="o", series="measured", parameters={})
            series = HistogramSeries(
                header=header, histogram=from_samples(values, 16), top=(), lowest=(), absent_count=0
            )
            origin = Origin(commit=fact.get("commit"), packages=fact.get("packages", {}))
            key = f"{seed:02x}{day:060d}{k:02d}"
            write_file(store, file_of("histograms", key), as_parquet(histogram_table(key, [series])))
            write_file(store, file_of("runs", key), as_parquet(run_table(key, record, origin)))
    return archive


def write_failed(
    archive: Path,
    start: datetime,
    reason: str | None,
    *,
    status: str = "failed",
    machine: str = "board",
    boot_id: str | None = None,
    parameters: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """A run that failed: in an archive it has a row and no measurements. Without `boot_id` the board did not answer."""
    record = RunRecord(
        schema=2,
        run=f"{start:%H%M}-oneshot",
        campaign="daily",
        suite="oneshot_timer_tests",
        parameters=PARAMETERS | {**parameters},
        platform=Platform.HARDWARE,
        platform_evidence="stated by the test",
        status=RunStatus(status),
        reason=reason,
        start_time=f"{start.isoformat()}Z",
        end_time=f"{start.isoformat()}Z",
        programs=[],
        outputs=[],
        target=TargetFacts(name=machine, boot_id=boot_id),
        files={},
    )
    key = hashlib.sha256(record.model_dump_json().encode()).hexdigest()
    table = run_table(key, record, Origin())
    write_file(make_archive(str(archive)), file_of("runs", key), as_parquet(table))


def write_build(root: Path, *levels_us: float, late: int = 0, seed: int = 99, platform: str = "hardware") -> Path:
    """The results of a build: a boot with two runs for each level."""
    boots = values_of_boots(levels_us, np.random.default_rng(seed))
    for k, values in enumerate(run for boot in boots for run in boot):
        values[:late] = 500_000
        target = {"name": "board", "kernel_release": "6.6", "boot_id": f"boot {k // 2} of the build"}
        record = {"platform": platform, "start_time": f"2027-01-01T10:{k:02}:00Z", "target": target}
        oneshot_run(root, f"{k:03d}-oneshot", values, **record)
    return root
