"""Reader of jitterdebugger's results.json (versions 0.1 to 0.3)."""

from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.results.importers.counts import (
    NO_INTERVAL,
    NO_ORDER,
    bins_of,
    histogram,
    load,
    numbered,
    overflow_of,
    statistics_in,
    whole,
)
from rtrun.results.importers.histogram_file import Imported
from rtrun.results.importers.origin import read_origin

_BINS = {1000: 1000, 1: 1_000_000}  # by resolution: the histogram ends at a millisecond


def read_results(path: Path, text: str) -> tuple[Imported, ...]:
    """Read one histogram per CPU. Raises UsageError naming file and place."""
    data = load(path, text)
    cpus, system = data.get("cpu"), data.get("sysinfo")
    if not isinstance(cpus, dict) or not cpus:
        raise UsageError(f"{path}: neither cyclictest's (cmdline, thread) nor jitterdebugger's (cpu) results")
    # Version 2 of the file added sysinfo, version 3 the resolution; version 1 has no version number.
    version = whole(path, "version", data.get("version", 1))
    facts = system if isinstance(system, dict) else {}
    resolution = whole(path, "sysinfo.resolution_in_ns", facts.get("resolution_in_ns", 1000 if version < 3 else None))
    if resolution not in _BINS:
        raise UsageError(f"{path}: sysinfo.resolution_in_ns: expected 1 or 1000, got {resolution}")
    limit = _BINS[resolution]
    threads = numbered(path, "cpu", cpus)
    online = whole(path, "sysinfo.cpus_online", facts.get("cpus_online", len(threads) if version < 2 else None))
    if online < len(threads):
        raise UsageError(f"{path}: sysinfo.cpus_online: {online}, but cpu has {len(threads)}")
    origin = read_origin(path, data)
    imported = []
    for name, cpu in threads.items():
        where = f"cpu.{name}"
        bins = bins_of(path, f"{where}.histogram", cpu.get("histogram"), limit=limit)
        overflow = overflow_of(path, f"{where}.count", cpu.get("count"), bins)
        left_out = [NO_ORDER, NO_INTERVAL]
        if overflow:
            left_out.append(f"{overflow} values beyond the last bin: only the largest is known")
        imported.append(
            Imported(
                source="jitterdebugger",
                name=f"jitterdebugger-cpu{name}",
                histogram=histogram(
                    bins, statistics_in(path, where, cpu), unit_ns=resolution, overflow=overflow, limit=limit
                ),
                period_ns=None,
                left_out=tuple(left_out),
                parameters={},
                unit_ns=resolution,
                origin=origin,
            )
        )
    return tuple(imported)
