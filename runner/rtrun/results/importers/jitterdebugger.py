"""Reader of jitterdebugger's results.json (versions 0.1 to 0.3)."""

from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.results.importers.counts import NO_ORDER, bins_of, histogram, load, mean_of, numbered, whole
from rtrun.results.importers.histogram_file import Imported

_BINS = 1000  # its histogram ends there


def read_results(path: Path, text: str) -> tuple[Imported, ...]:
    """One histogram a CPU. Raises UsageError naming file and place."""
    data = load(path, text)
    cpus, system = data.get("cpu"), data.get("sysinfo")
    if not isinstance(cpus, dict) or not cpus:
        raise UsageError(f"{path}: neither cyclictest's (cmdline, thread) nor jitterdebugger's (cpu) results")
    resolution = system.get("resolution_in_ns", 1000) if isinstance(system, dict) else 1000
    if resolution not in (1, 1000):
        raise UsageError(f"{path}: sysinfo.resolution_in_ns: expected 1 or 1000, got {str(resolution)[:40]!r}")
    imported = []
    for name, cpu in numbered(path, "cpu", cpus).items():
        where = f"cpu.{name}"
        bins = bins_of(path, f"{where}.histogram", cpu.get("histogram", {}))
        count, most = whole(path, f"{where}.count", cpu.get("count")), whole(path, f"{where}.max", cpu.get("max"))
        overflow = count - sum(bins.values())
        if overflow < 0:
            raise UsageError(f"{path}: {where}.count: {count}, but the bins hold {sum(bins.values())}")
        limit = max(_BINS, max(bins, default=-1) + 1)
        left_out = [NO_ORDER, "the interval"]
        if overflow:
            left_out.append(f"{overflow} values beyond the last bin: only the largest is known")
        imported.append(
            Imported(
                source="jitterdebugger",
                name=f"jitterdebugger-cpu{name}",
                histogram=histogram(
                    bins,
                    unit_ns=resolution,
                    width=1,
                    overflow=overflow,
                    overflow_from=limit,
                    max_value=most,
                    mean_value=mean_of(path, f"{where}.avg", cpu.get("avg")),
                ),
                period_ns=None,
                left_out=tuple(left_out),
                parameters={},
            )
        )
    return tuple(imported)
