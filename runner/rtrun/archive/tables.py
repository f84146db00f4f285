"""The tables of an archive: their columns, and the rows of one run (docs/archive.md).

A row of `runs` has all circumstances of a run. A row of `histograms` is a bin of a series that an output may be judged
by; a cyclic timer has two such series. A row of `samples` is one of its values.
"""

import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet

from rtfiles.errors import UsageError
from rtrun.analysis.histogram import from_samples
from rtrun.archive.files import ROW_GROUP
from rtrun.kinds.limits import BINS_MAX
from rtrun.plan.observation import stream_words
from rtrun.plan.short_names import format_parameters
from rtrun.plan.suites import telling_parameters
from rtrun.results.record import FILE, RunRecord, moment
from rtrun.results.series import HistogramSeries, SampleSeries, Series
from rtrun.targets.inspection.facts import TargetState, fact_text, memory_kib, processor

Table = Any  # pyarrow has no types
_TEXTS = (
    *("run_key", "run", "campaign", "suite", "machine", "scenario", "parameters", "condition", "settings", "variant"),
    "platform",
)
_FACTS = (
    *("platform_evidence", "status", "reason", "boot_id", "address", "kernel_release", "kernel_version"),
    *("architecture", "cpu", "command_line", "clock_source", "clock_event", "governor", "middleware_version", "setup"),
    *("commit", "image", "packages", "record"),
)
COMMAND_LINE_MAX = 4096  #: characters of a kernel command line in an archive, as most kernels have
_TARGET_FACTS = ("boot_id", "kernel_release", "kernel_version", "governor", "middleware_version", "setup")
RUNS = pyarrow.schema(
    [
        *((name, pyarrow.string()) for name in (*_TEXTS, *_FACTS)),
        *((name, pyarrow.timestamp("us")) for name in ("start_utc", "end_utc")),
        *((name, pyarrow.bool_()) for name in ("preempt_rt", "off_rate")),
        *((name, pyarrow.int64()) for name in ("cpus", "clock_step_ns", "temperature_min_mc", "temperature_max_mc")),
        *((name, pyarrow.int64()) for name in ("frequency_min_khz", "frequency_max_khz", "memory_kib")),
        *((name, pyarrow.float64()) for name in ("load_1min_min", "load_1min_max", "busy_percent")),
    ]
)
HISTOGRAMS = pyarrow.schema(
    [
        *((name, pyarrow.string()) for name in ("run_key", "output", "series")),
        *((name, pyarrow.int64()) for name in ("value_ns", "bin_ns", "count")),
    ]
)
SAMPLES = pyarrow.schema(
    [
        *((name, pyarrow.string()) for name in ("run_key", "output", "series")),
        *((name, pyarrow.int64()) for name in ("index", "value_ns")),
    ]
)
SCHEMAS = {"histograms": HISTOGRAMS, "samples": SAMPLES, "runs": RUNS}
"""The tables, in the order in which a run is written."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Origin:
    """What run.json does not have: the commit and the image under test, and package versions by package name."""

    commit: str | None = None
    image: str | None = None
    packages: Mapping[str, str] = field(default_factory=dict)


def key_of(folder: Path) -> str:
    """The name of a run in every archive: the SHA-256 of its run.json, which contains the SHA-256 of its files."""
    return hashlib.sha256((folder / FILE).read_bytes()).hexdigest()


def file_of(table: str, name: str) -> str:
    """The path of a table's file within the archive."""
    return f"{table}/{name}.parquet"


def run_table(key: str, record: RunRecord, origin: Origin, state: TargetState | None = None) -> Table:
    """The row of a run in the table of runs; `state` is that of its target before it."""
    target, seen = record.target, record.in_effect
    ranges = {
        f"{name}_{end}{unit}": value
        for name, unit, values in (
            ("temperature", "_mc", seen.temperature_mc),
            ("frequency", "_khz", seen.frequency_khz),
            ("load_1min", "", seen.load_1min),
        )
        for end, value in zip(("min", "max"), values or (None, None), strict=True)
    }
    telling = telling_parameters(record.circumstances)
    observed, others = stream_words(record.suite, telling)
    row: dict[str, Any] = {
        "run_key": key,
        **{name: getattr(record, name) for name in ("run", "campaign", "suite", "condition", "variant", "reason")},
        "machine": target.name,
        "scenario": f"{observed or record.suite.removesuffix('_tests')} {format_parameters(others)}".rstrip(),
        "parameters": _json(telling),
        "settings": _json(record.settings),
        "platform": str(record.platform),
        "platform_evidence": record.platform_evidence,
        "status": str(record.status),
        **{name: fact_text(getattr(target, name)) for name in _TARGET_FACTS},
        "address": target.address,
        "architecture": fact_text(target.machine),
        "cpu": state and processor(state),
        "command_line": (state and (fact_text(state.cmdline) or "")[:COMMAND_LINE_MAX]) or None,
        "memory_kib": state and memory_kib(state),
        "clock_source": fact_text(target.clock.source if target.clock else target.clocksource),
        "clock_event": fact_text(target.clock.event if target.clock else None),
        "commit": origin.commit,
        "image": origin.image,
        "packages": _json(origin.packages),
        "record": record.model_dump_json(by_alias=True, exclude_unset=True),
        "start_utc": _utc(record.start_time),
        "end_utc": _utc(record.end_time),
        "preempt_rt": target.preempt_rt,
        "off_rate": record.is_off_rate,
        "cpus": target.cpus,
        "clock_step_ns": target.clock.step_ns if target.clock else None,
        **ranges,
        "busy_percent": seen.busy_percent,
    }
    return pyarrow.Table.from_pylist([row], RUNS)


def histogram_table(key: str, judged: Iterable[Series]) -> Table:
    """The bins of a run's outputs, ascending: samples in steps of their clock, logs in their own bins.

    Two kinds of rows are added: a row without ``value_ns`` counts what never came; a row without ``bin_ns`` counts
    values that are known by number only, and its ``value_ns`` is a lower bound of them. Raises UsageError where there
    are more than BINS_MAX rows.
    """
    parts = [_bins(key, series) for series in judged]
    if (rows := sum(part.num_rows for part in parts)) > BINS_MAX:
        raise UsageError(f"{key}: {rows} bins, an archive takes at most {BINS_MAX} of a run")
    return pyarrow.concat_tables(parts) if parts else HISTOGRAMS.empty_table()


def _bins(key: str, series: Series) -> Table:
    if isinstance(series, SampleSeries):
        histogram = from_samples(series.values_ns, max(1, series.header.clock_step_ns or 1))
        absent = series.absent.size
    else:
        histogram, absent = series.histogram, series.absent_count
    values, counts = histogram.values_ns.tolist(), histogram.counts.tolist()
    widths: list[int | None] = [histogram.bin_ns] * len(values)
    if histogram.overflow:
        values, counts, widths = (
            [*values, histogram.overflow_from_ns or 0],
            [*counts, histogram.overflow],
            [*widths, None],
        )
    if absent:
        values, counts, widths = [*values, None], [*counts, absent], [*widths, None]
    return pyarrow.Table.from_arrays([*_names(key, series, len(values)), values, widths, counts], schema=HISTOGRAMS)


def sample_table(key: str, judged: Iterable[Series]) -> Table:
    """The values of a run's outputs, each with its loop, without the start-up; nothing for outputs without samples."""
    parts = [
        pyarrow.Table.from_arrays(
            [*_names(key, series, series.values_ns.size), series.index, series.values_ns], schema=SAMPLES
        )
        for series in judged
        if not isinstance(series, HistogramSeries)
    ]
    return pyarrow.concat_tables(parts) if parts else SAMPLES.empty_table()


def _names(key: str, series: Series, rows: int) -> list[Any]:
    names = (key, series.header.output, series.header.series)
    return [
        pyarrow.DictionaryArray.from_arrays(np.zeros(rows, np.int8), [name]).cast(pyarrow.string()) for name in names
    ]


def as_parquet(table: Table) -> bytes:
    """A table as a Parquet file; the same table gives the same bytes."""
    stream = io.BytesIO()
    pyarrow.parquet.write_table(table, stream, compression="zstd", row_group_size=ROW_GROUP, store_schema=False)
    return stream.getvalue()


def _utc(text: str) -> datetime | None:
    """A time of a record in UTC, without its zone; None where an imported run has none."""
    time = moment(text)
    return time and time.replace(tzinfo=None)


def _json(mapping: Mapping[str, Any]) -> str:
    return json.dumps(mapping, sort_keys=True)
