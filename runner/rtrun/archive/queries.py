"""What an archive answers, by DuckDB: figures of runs together, from their histograms.

A percentile is the lower edge of the bin that holds the value of its rank (nearest rank, as in every report). So it is
the report's figure, rounded down to a step of the clock.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from rtfiles.errors import UsageError
from rtrun.analysis.figures import PERCENTILES
from rtrun.archive import By
from rtrun.archive.store import Store, find_files
from rtrun.archive.tables import HISTOGRAMS

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

_LABELS: dict[By, str] = {
    "day": "coalesce(strftime(start_utc, '%Y-%m-%d'), 'unknown')",
    "month": "month",
    "kernel": "coalesce(kernel_release, 'unknown')",
    "board": "machine",
    "commit": "coalesce(commit, 'unknown')",
    "image": "coalesce(image, 'unknown')",
    "run": "coalesce(strftime(start_utc, '%Y-%m-%d %H:%M:%S '), '') || run",
}
# Which points follow one another: by time, and for boards and kernels side by side.
_ORDERS: dict[By, str] = {"kernel": "label, machine, start_utc", "board": "machine, start_utc"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """Runs of one scenario on one board and kernel together.

    `run_keys` are their names in the archive. `n` counts what was asked for but for the start-up; `misses` are late or
    never came, None where a histogram does not reach to the deadline. `unclear` of them lie in the bin of the deadline
    and may have met it. A percentile or the highest value is None where it is among values known by number only.
    """

    scenario: str
    parameters: str
    suite: str
    machine: str
    platform: str
    kernel: str | None
    label: str
    start_utc: datetime | None
    run_keys: tuple[str, ...]
    boots: int
    n: int
    misses: int | None
    unclear: int
    percentiles_ns: dict[float, int | None]
    max_ns: int | None

    @property
    def p_miss(self) -> float | None:
        """The share of the measurements that missed the deadline."""
        return None if self.misses is None or not self.n else self.misses / self.n


@contextmanager
def connected(store: Store) -> "Iterator[DuckDBPyConnection]":
    """DuckDB with the views `runs` and `histograms` of an archive.

    Raises UsageError when it has no runs; what DuckDB says of a damaged file becomes one, too.
    """
    import duckdb

    if not find_files(store, "runs"):
        raise UsageError(f"{store.address}: there are no runs in this archive")
    connection = duckdb.connect(config={"autoinstall_known_extensions": False})
    try:
        if not store.is_local:
            connection.register_filesystem(store.file_system)
        for table in ("runs", "histograms"):
            if find_files(store, table):
                files = store.url(f"{table}/**/*.parquet").replace("'", "''")
                source = f"read_parquet('{files}', hive_partitioning = true, hive_types_autocast = false)"
            else:
                columns = ", ".join(f"NULL::{_TYPES[str(field.type)]} AS {field.name}" for field in HISTOGRAMS)
                source = f"(SELECT {columns} LIMIT 0)"
            connection.execute(f"CREATE VIEW {table} AS FROM {source}")
        yield connection
    except duckdb.Error as error:
        text = str(error).splitlines()[0]
        raise UsageError(f"{store.address}: {text}; rtrun archive add writes a file anew that is not whole") from error
    finally:
        connection.close()


_TYPES = {"string": "VARCHAR", "int64": "BIGINT"}


def figures(connection: "DuckDBPyConnection", by: By, *, deadline_ns: int) -> list[Point]:
    """The figures of every point, scenario by scenario; runs that are not ok are in none."""
    # The rank in whole numbers, so that no rounding moves it.
    percentiles = ", ".join(f"min(value_ns) FILTER (reached * 100000 >= came * {round(1000 * p)})" for p in PERCENTILES)
    query = _QUERY.format(
        label=_LABELS[by],
        order=_ORDERS.get(by, "machine, start_utc"),
        percentiles=percentiles,
        nothing=", ".join(["NULL"] * len(PERCENTILES)),
    )
    cursor = connection.execute(query, {"deadline": deadline_ns})
    names = [column[0] for column in cursor.description or ()]
    return [_point(dict(zip(names, row, strict=True))) for row in cursor.fetchall()]


def _point(row: dict[str, Any]) -> Point:
    limit_ns = row.pop("unknown_from_ns")  # from here on values are known by number only
    values = [
        value if limit_ns is None or value is None or value < limit_ns else None
        for value in (row["max_ns"], *row["percentiles_ns"])
    ]
    return Point(
        **(
            row
            | {"run_keys": tuple(row["run_keys"]), "max_ns": values[0]}
            | {"percentiles_ns": dict(zip(PERCENTILES, values[1:], strict=True))}
        )
    )


_QUERY = """
WITH points AS (
    SELECT row_number() OVER () AS point, scenario, parameters, suite, machine, platform, kernel_release AS kernel,
           kernel_version, {label} AS label, min(runs.start_utc) AS start_utc,
           list(run_key ORDER BY runs.start_utc, run_key) AS run_keys,
           count(DISTINCT coalesce(boot_id, run_key)) AS boots
    FROM runs WHERE status = 'ok'
    GROUP BY scenario, parameters, suite, machine, platform, kernel_release, kernel_version, {label}
), members AS (
    SELECT point, unnest(run_keys) AS run_key FROM points
), bins AS (
    SELECT point, value_ns, bin_ns, sum(count)::BIGINT AS count
    FROM histograms JOIN members USING (run_key) GROUP BY point, value_ns, bin_ns
), ranked AS (
    SELECT *, sum(count) OVER (PARTITION BY point ORDER BY value_ns)::BIGINT AS reached,
           sum(count) OVER (PARTITION BY point)::BIGINT AS came
    FROM bins WHERE value_ns IS NOT NULL
), ordered AS (
    SELECT point, max(value_ns) AS max_ns, min(value_ns) FILTER (bin_ns IS NULL) AS unknown_from_ns,
           [{percentiles}] AS percentiles_ns
    FROM ranked GROUP BY point
), counted AS (
    SELECT point, sum(count)::BIGINT AS n,
           CASE WHEN coalesce(bool_or(bin_ns IS NULL AND value_ns < $deadline), false) THEN NULL
                ELSE coalesce(sum(count) FILTER (value_ns IS NULL OR bin_ns IS NULL
                                                 OR value_ns > $deadline - bin_ns + 1), 0)::BIGINT END AS misses,
           coalesce(sum(count) FILTER (value_ns <= $deadline
                                       AND value_ns > $deadline - bin_ns + 1), 0)::BIGINT AS unclear
    FROM bins GROUP BY point
)
SELECT scenario, parameters, suite, machine, platform, kernel, label, start_utc, run_keys, boots, n, misses, unclear,
       max_ns, unknown_from_ns, coalesce(percentiles_ns, [{nothing}]) AS percentiles_ns
FROM points JOIN counted USING (point) LEFT JOIN ordered USING (point)
ORDER BY scenario, parameters, platform, {order}, label, kernel_version
"""
