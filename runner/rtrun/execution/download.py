"""Download of a run's files. Their names, sizes and contents come from the target and are checked."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from rtfiles.errors import UsageError
from rtrun.plan import suites
from rtrun.results import partial_samples
from rtrun.results.gnuplot_lines import check_commands
from rtrun.targets import connection
from rtrun.targets.link import Link

MIB = 1024 * 1024
STREAM_LIMIT_BYTES = 16 * MIB  #: standard output or standard error of a program, as copied
JSON_LIMIT_BYTES = 16 * MIB  #: a JSON file of a suite, as copied
LOG_LIMIT_BYTES = 64 * MIB  #: a log of a suite, as copied
NPY_HEADER_BYTES = 64 * 1024
TRACE_LIMIT_BYTES = 64 * MIB  #: a kernel trace, as copied
# Some lines for each control group, whose path has 4096 characters at most.
CGROUPS_LIMIT_BYTES = MIB  #: recorded control groups of a program
TRACES_MAX = 16  #: kernel traces of an output of a suite
# Text that is useful even when it is cut off.
_STREAMS = (".stdout", ".stderr")
# Works on a full disk, and with any dd.
_CUT = 'cd "$1" && dd if=/dev/null of="$2" bs=1 seek="$3" 2>/dev/null'
_TRACES = "-trace-*.txt"
_TRACE = re.compile(r"(.+)-trace-[0-9]{1,18}\.txt", re.ASCII)


def expected_files(
    suite: str, programs: Sequence[str], outputs: Sequence[str], rows: int, *, traced: bool
) -> dict[str, int]:
    """Return the files that a run may write, name to the largest plausible size in bytes.

    A `traced` run also writes traces; their name is a pattern: ``<output>-trace-*.txt``.
    """
    limits = dict.fromkeys((f"{name}{kind}" for name in programs for kind in _STREAMS), STREAM_LIMIT_BYTES)
    for output in outputs:
        logs = [f"{output}-{log}.log" for log in suites.suite(suite).logs] or [f"{output}.log"]
        limits |= dict.fromkeys(logs, LOG_LIMIT_BYTES)
        # Duplicated messages may come on top of the rows asked for.
        limits[f"{output}.npy"] = 2 * rows * 8 * len(suites.suite(suite).columns) + NPY_HEADER_BYTES
        limits[f"{output}{partial_samples.ENDING}"] = limits[f"{output}.npy"]
        limits[f"{output}.json"] = JSON_LIMIT_BYTES
        if traced:
            limits[f"{output}{_TRACES}"] = TRACE_LIMIT_BYTES
    return limits


def listing(folder: PurePosixPath, limits: Mapping[str, int]) -> list[str]:
    """The command that lists the files of a run that `limits` names, for `parse_listing`."""
    return connection.listing(folder, limits, matches_max=TRACES_MAX)


def pull(
    link: Link, source: PurePosixPath, present: Mapping[str, int], destination: Path, limits: Mapping[str, int]
) -> dict[str, str]:
    """Copy the expected files of a run; return those that were not taken, or only in part, name to reason.

    `present` are the files in `source` with their sizes in bytes.
    The output of a program is cut off at its limit on the target, where no program of the run is alive any more.
    A log with commands that no suite writes is kept as ``<name>.refused``: gnuplot would execute them.

    Raises TargetError when a file arrives with another checksum than it has on the target.
    """
    limits = {**limits, **_traces(present, limits)}
    wanted = {name: size for name, size in present.items() if name in limits}
    refused: dict[str, str] = {}
    for name, size in list(wanted.items()):
        if size <= limits[name]:
            continue
        refused[name] = f"{name} has {size} bytes, at most {limits[name]} were expected: "
        if name.endswith(_STREAMS) and _cut(link, source, name, limits[name]):
            wanted[name] = limits[name]
            refused[name] += "the rest was not taken"
        else:
            del wanted[name]
            refused[name] += "it was not taken"
    if wanted:
        link.do(lambda connected: connected.download(source, wanted, destination))
    for name in wanted:
        if name.endswith(partial_samples.ENDING):
            partial_samples.salvage(destination / name)
        if name.endswith(".log"):
            try:
                check_commands(destination / name)
            except UsageError as error:
                # Not under a name that a user may pass to gnuplot.
                (destination / name).rename(destination / f"{name}.refused")
                refused[name] = f"kept as {name}.refused: {str(error).replace(f'{destination}/', '')}"
    return refused


def _cut(link: Link, folder: PurePosixPath, name: str, size_bytes: int) -> bool:
    return link.run(["sh", "-c", _CUT, "sh", str(folder), name, str(size_bytes)]).status == 0


def _traces(present: Iterable[str], limits: Mapping[str, int]) -> dict[str, int]:
    """Return the traces among the files present, with their limit. Only the suite knows which indices they have."""
    outputs = [name.removesuffix(_TRACES) for name in limits if name.endswith(_TRACES)]
    traces = sorted(name for name in present if (trace := _TRACE.fullmatch(name)) and trace[1] in outputs)
    return dict.fromkeys(traces[: TRACES_MAX * len(outputs)], TRACE_LIMIT_BYTES)
