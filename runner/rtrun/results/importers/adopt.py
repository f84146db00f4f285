"""Make run directories from files of other programs, so that everything else can read them."""

import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from rtfiles import atomic
from rtfiles.errors import UsageError
from rtfiles.output import printable
from rtfiles.untrusted import read_bytes
from rtrun.plan.suites import Value, kind_of, period_of
from rtrun.results import run_directory
from rtrun.results.gnuplot_lines import MAX_SIZE_BYTES
from rtrun.results.gnuplot_log import read_log
from rtrun.results.importers.detect import read
from rtrun.results.importers.given import NOTHING_GIVEN, Given
from rtrun.results.importers.histogram_file import ENDING, Imported, histogram_text
from rtrun.results.importers.identity import Identity, target_facts, times
from rtrun.results.importers.origin import NOWHERE, FileOrigin
from rtrun.results.importers.samples_file import ImportedSamples, write_samples
from rtrun.results.record import RunRecord, RunStatus
from rtrun.targets.inspection.platform import Platform

UNKNOWN_IDENTITY = Identity()


def adopt(
    path: Path,
    results: Path,
    *,
    platform: Platform,
    identity: Identity = UNKNOWN_IDENTITY,
    called: str | None = None,
    given: Given = NOTHING_GIVEN,
) -> list[tuple[Path, tuple[str, ...]]]:
    """Import one file into `results`; returns each run directory made and what its format leaves out.

    `called` is the name of the run, by default the name of the file; `given` is what the user states about its numbers.
    A log keeps its name and is read as a log of its suite; other files become histograms or samples, one run per
    context. Raises UsageError when the file cannot be read or contradicts the user, or when a run of that name exists.
    """
    if printable(path.name) != path.name:
        raise UsageError(f"{printable(str(path))}: a name of plain text is needed, rename the file")
    name = re.sub(r"[^A-Za-z0-9._-]", "_", called or path.stem) or "imported"
    if path.suffix == ".log" and b"# Plot data for gnuplot" in read_bytes(path, max_bytes=MAX_SIZE_BYTES):
        log = read_log(path)
        kind = kind_of(log.suite)
        named = kind.logs.series if kind and kind.logs else {}
        endings = {series: f"-{ending}" for ending, series in named.items() if ending}
        output = next(
            (path.stem.removesuffix(ending) for ending in endings.values() if path.stem.endswith(ending)), path.stem
        )
        given.check(path, unit_ns=1000, period_ns=period_of(log.parameters))
        record = _record(name, results, log.suite, log.parameters, [output], platform, path, identity)
        folder = _new(results, name)
        # A log may have been renamed: this name makes it a log of the output.
        ending = endings.get(log.series, "")
        with run_directory.filling(folder) as partial:
            shutil.copyfile(path, partial / f"{output}{ending}.log")
            run_directory.close(partial, folder, record)
        return [(folder, ("the samples, and their order but for the listed extremes", *log.remarks))]
    adopted = []
    contexts: dict[str, list[Imported | ImportedSamples]] = {}
    for imported in read(path, given):
        contexts.setdefault(str(imported.parameters.get("context", "")), []).append(imported)
    for context, members in contexts.items():
        run = f"{name}-{context}" if context else name
        folder = _new(results, run)
        first = members[0]
        record = _record(
            run,
            results,
            first.source,
            first.parameters,
            [member.name for member in members],
            platform,
            path,
            identity,
            first.origin,
        )
        with run_directory.filling(folder) as partial:
            shutil.copyfile(path, partial / f"original{path.suffix}")
            for member in members:
                if isinstance(member, Imported):
                    atomic.write_text(partial / f"{member.name}{ENDING}", histogram_text(member))
                else:
                    write_samples(partial, member)
            run_directory.close(partial, folder, record)
        adopted.append((folder, tuple(dict.fromkeys(text for member in members for text in member.left_out))))
    return adopted


def _new(results: Path, run: str) -> Path:
    folder = results / run
    if folder.exists():
        raise UsageError(f"{folder}: there already, give another --results or remove it")
    return folder


def _record(
    run: str,
    results: Path,
    suite: str,
    parameters: Mapping[str, Value],
    outputs: Sequence[str],
    platform: Platform,
    path: Path,
    identity: Identity,
    origin: FileOrigin = NOWHERE,
) -> RunRecord:
    start_time, end_time = times(identity, path, origin)
    return RunRecord(
        schema=2,
        run=run,
        campaign=results.name,
        suite=suite,
        parameters=dict(parameters),
        platform=platform,
        platform_evidence="stated when it was imported",
        status=RunStatus.FAILED if origin.failure else RunStatus.OK,
        reason=origin.failure,
        start_time=start_time,
        end_time=end_time,
        programs=[],
        outputs=list(outputs),
        target=target_facts(identity, path, origin),
        files={},
    )
