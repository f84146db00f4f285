"""Where a topology's late reactions spent their time, as a table."""

from collections.abc import Sequence
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.quantities import time
from rtrun.flows.topology.late import LatePath, PathPart, late_path
from rtrun.flows.topology.tables import read_tables
from rtrun.plan.topology.topology import NodePath
from rtrun.report.tables import Table
from rtrun.results.run_directory import closing_record
from rtrun.results.topology_record import FILE, TopologyRecord, read_topology_record

# Parts that caused less than this share of a reaction's lateness are not listed.
LISTED_FROM = 0.02


def late_paths(folders: Sequence[Path]) -> tuple[Table | None, tuple[str, ...]]:
    """A row for each part that made reactions and responses late, of runs of topologies; why one cannot be read.

    The table is None where there are no topologies.
    """
    found: list[tuple[str, LatePath]] = []
    refused: list[str] = []
    for folder in dict.fromkeys(folders):
        try:
            if (record := read_topology_record(folder)) is not None:
                found += ((folder.name, path) for path in _of_run(folder, record))
        except UsageError as error:
            refused.append(str(error))
    if not found:
        return None, tuple(refused)
    rows = [
        (
            run if number == 0 else "",
            f"{_name(path)}: {path.late} of {path.reactions} above {time(path.limit_ns)}" if number == 0 else "",
            part.what,
            time(round(part.late_ns)),
            time(round(part.otherwise_ns)) if path.late < path.reactions else "-",
            f"{100 * path.share(part):.0f} %",
        )
        for run, path in found
        for number, part in enumerate(_listed(path))
    ]
    return Table(
        id="late_paths",
        title="Where late reactions and responses spent their time",
        columns=("run", "path", "part", "late", "otherwise", "of what made them late"),
        rows=rows,
        outcome=_outcome(found),
        numbers=range(3, 6),
        notes=("Means of the late ones and of the others, from the tables of the nodes themselves.",),
    ), tuple(refused)


def _of_run(folder: Path, record: TopologyRecord) -> list[LatePath]:
    tables = read_tables(folder, record.topology)
    deadlines = {path.topics: path.reaction_ns for path in record.topology.paths}
    paths = (NodePath(topics=tuple(path.topics), nodes=tuple(path.nodes)) for path in record.paths)
    found = [late_path(tables, path, deadlines.get(path.topics)) for path in paths]
    # A response is a reaction along a path with a single node.
    found += (
        late_path(tables, NodePath(topics=(), nodes=(node.name,)), node.deadline_ns)
        for node in record.topology.nodes
        if node.deadline_ns
    )
    return [path for path in found if path is not None and path.extra_ns > 0]


def run_of(folder: Path) -> Path:
    """The run of the topology whose stream is in this folder; otherwise the folder itself."""
    closed = None if (folder / FILE).is_file() else closing_record(folder)
    run = folder.with_name(closed.observed_by) if closed and closed.observed_by else folder
    return run if (run / FILE).is_file() else folder


def _name(found: LatePath) -> str:
    return f"{found.path.name} -> {found.path.sink}" if found.path.topics else f"response of {found.path.sink}"


def _listed(path: LatePath) -> list[PathPart]:
    return [part for part in path.parts if path.share(part) >= LISTED_FROM]


def _outcome(found: Sequence[tuple[str, LatePath]]) -> str:
    """The part that contributed most to late reactions, in one sentence."""
    worst = max((path for _, path in found), key=lambda path: path.parts[0].extra_ns)
    part = worst.parts[0]
    more = f"{time(round(part.extra_ns))} more than otherwise"
    return f"{part.what}: {more}, {100 * worst.share(part):.0f} % of what made {_name(worst)} late"
