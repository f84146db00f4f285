"""The reader of samples: what it takes from good ones, and that it refuses every bad one by name."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written import write_communication, write_cyclic, write_oneshot, write_output

from rtfiles.errors import UsageError
from rtrun.kinds.values import IndexedValues
from rtrun.results.samples import read_samples


def as_pairs(series: IndexedValues) -> list[tuple[int, int]]:
    return list(zip(series.index.tolist(), series.values_ns.tolist(), strict=True))


def test_oneshot_leaves_out_what_did_not_fire_and_keeps_the_indices(tmp_path: Path) -> None:
    samples = read_samples(write_oneshot(tmp_path))
    assert as_pairs(samples.series["measured"]) == [(0, 50_000), (1, 60_000), (3, 100)]
    assert as_pairs(samples.series["reported"]) == [(0, 58_000), (1, 67_500), (3, -400)]
    assert as_pairs(samples.series["difference"]) == [(0, 8000), (1, 7500), (3, -500)]
    assert list(samples.series) == ["measured", "reported", "difference", "measured_2014", "difference_2014"]
    assert as_pairs(samples.series["measured"]) == [(0, 50_000), (1, 60_000), (3, 100)]
    assert as_pairs(samples.series["measured_2014"]) == [(0, 43_000), (1, 53_000), (3, -6_900)]
    assert as_pairs(samples.series["difference_2014"]) == [(0, 15_000), (1, 14_500), (3, 6_500)]


def test_cyclic_counts_from_the_exact_period(tmp_path: Path) -> None:
    samples = read_samples(write_cyclic(tmp_path))
    assert as_pairs(samples.series["jitter"]) == [(0, 500), (1, -500), (2, 0)]
    assert as_pairs(samples.series["grid"]) == [(0, 500), (1, 0), (2, 0)]
    assert as_pairs(samples.series["lateness"]) == [(0, 9), (1, 9), (2, 9)]


@pytest.mark.parametrize("names", [[], ["timestamp_ns", "real_ns", "expected_ns"], ["timestamp_ns"]])
def test_other_columns_than_those_of_the_suite_are_refused(tmp_path: Path, names: list[str]) -> None:
    path = write_cyclic(tmp_path)
    change_record(path, columns=names)
    with pytest.raises(UsageError, match=r"json: columns: .*, must be timestamp_ns, expected_ns, real_ns"):
        read_samples(path)


def write_calls(folder: Path, calls: list[tuple[float, float]], skipped: int | None = None) -> Path:
    """Calls of a 1 kHz timer as roscpp makes them: when each was due, and when it came, in periods."""
    wall_ns, period_ns = 1_800_000_000 * 10**9, 1_000_000
    rows = [
        (place * period_ns, wall_ns + round(due * period_ns), wall_ns + round(real * period_ns))
        for place, (due, real) in enumerate(calls)
    ]
    requested = {"repetitions": len(calls) - 1, "frequency_hz": 1000}
    counts = {"asked": len(calls) - 1, "measured": len(calls) - 1}
    path = write_output(folder, "c", "cyclic_timer_tests", rows, requested=requested, **counts)
    change_record(path, rate={"asked_hz": 1000, "achieved_hz": None, "overruns": 0, "skipped": skipped})
    return path


@pytest.mark.parametrize(
    ("calls", "lateness_us", "absent"),
    [
        ([(1, 1.25), (2, 2.5), (3, 3)], [500, 0], []),
        ([(1, 1), (2, 3.75), (3, 3.75), (4, 4)], [1750, 750, 0], []),
        # Those due at 3 to 6 are skipped, and that due at 7 is late: to move the grid is no pardon.
        ([(1, 1), (2, 7.25), (7.25, 7.25), (8.25, 8.25)], [5250, 250, 0], [1, 2, 3, 4]),
        ([(1, 1), (2, 2), (4.5, 4.5), (5.5, 5.5)], [0, 500, 0], [1]),
        ([(1000, 1000), (3, 2), (4, 4)], [-1000, 0], []),
    ],
    ids=["kept", "made up for", "moved", "a long call", "the wall clock was put back"],
)
def test_lateness_is_held_against_the_grid_as_it_was(
    tmp_path: Path, calls: list[tuple[float, float]], lateness_us: list[int], absent: list[int]
) -> None:
    lateness = read_samples(write_calls(tmp_path, calls)).series["lateness"]
    assert lateness.values_ns.tolist() == [1000 * value for value in lateness_us]
    assert lateness.absent.tolist() == absent


@pytest.mark.parametrize(
    ("calls", "skipped", "message"),
    [
        ([(0, 0), (1, 5e12)], None, r"a time of the wall clock below 0 or above 4294967296000000000 ns cannot be"),
        ([(0, 0), (-1.9e12, 0)], None, r"a time of the wall clock below 0"),
        ([(0, 0), (-1.5e12, 1)], None, r"a time beyond 1000000000000000000 ns cannot be"),
        ([(0, 0), (2e7, 2e7)], None, r"19999999 periods were skipped: none with more than 10000000 is read"),
        ([(0, 0), (3, 3)], 1, r"disagree: skipped: 2 in the rows, 1 in the counts"),
    ],
)
def test_times_of_the_wall_clock_that_cannot_be_are_refused(
    tmp_path: Path, calls: list[tuple[float, float]], skipped: int | None, message: str
) -> None:
    path = write_calls(tmp_path, calls, skipped)
    with pytest.raises(UsageError, match=message):
        read_samples(path)


def test_communication_comes_in_sequence_order(tmp_path: Path) -> None:
    samples = read_samples(write_communication(tmp_path).with_suffix(".npy"))
    assert as_pairs(samples.series["latency"]) == [(0, 200_000), (1, 400_000), (2, 300_000), (3, 100_000)]
    counts = samples.record.counts
    assert (counts.measured, counts.missing, counts.duplicate, counts.out_of_order) == (4, 1, 1, 1)


def change_record(path: Path, **changed: Any) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))


@pytest.mark.parametrize(
    ("write", "count", "message"),
    [
        (write_oneshot, {"measured": 4, "not_fired": 0}, "measured: 3 in the rows, 4 in the counts"),
        (write_oneshot, {"not_fired": 0}, "not fired: 1 in the rows, 0 in the counts"),
        (write_cyclic, {"measured": 4, "asked": 4}, "measured periods: 3 in the rows, 4 in the counts"),
        (write_communication, {"measured": 5, "missing": 0}, "measured: 4 in the rows, 5 in the counts"),
        (write_communication, {"missing": 0}, "missing: 1 in the rows, 0 in the counts"),
        (write_communication, {"out_of_order": 0}, "out of order: 1 in the rows, 0 in the counts"),
    ],
)
def test_rows_and_counts_that_disagree_are_refused_naming_both(
    tmp_path: Path, write: Callable[[Path], Path], count: dict[str, int], message: str
) -> None:
    path = write(tmp_path)
    change_record(path, counts=json.loads(path.read_text())["counts"] | count)
    with pytest.raises(UsageError) as error:
        read_samples(path)
    assert str(error.value) == f"{path.with_suffix('.npy')} and {path.name} disagree: {message}"


class Bomb:
    """Unpickling it would fail the test."""

    def __reduce__(self) -> tuple[Callable[..., None], tuple[str]]:
        return pytest.fail, ("the npy was unpickled",)


def test_a_pickle_is_never_loaded(tmp_path: Path) -> None:
    path = write_cyclic(tmp_path).with_suffix(".npy")
    np.save(path, np.array([Bomb(), Bomb()], dtype=object), allow_pickle=True)
    with pytest.raises(UsageError, match=r"npy: values of type \|O, must be <i8"):
        read_samples(path)
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(UsageError, match=r"npy: not in NumPy format 1\.0"):
        read_samples(path)


def test_an_npy_cut_off_or_grown_is_refused(tmp_path: Path) -> None:
    path = write_oneshot(tmp_path).with_suffix(".npy")
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(UsageError, match="npy: "):
            read_samples(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(UsageError, match="289 bytes, 4 rows take 288: cut off or not of one piece"):
        read_samples(path)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 4), dtype="<i4"), "values of type <i4, must be <i8"),
        (np.zeros((4, 4), dtype=">i8"), "values of type >i8, must be <i8"),
        (np.zeros((4, 3), dtype="<i8"), r"shape \(4, 3\), must be \(rows, 5\) of start_ns, end_ns"),
        (np.zeros(16, dtype="<i8"), r"shape \(16,\), must be \(rows, 5\)"),
        (np.array(3, dtype="<i8"), r"shape \(\), must be"),
        (np.zeros((4, 5), dtype="<i8", order="F"), "in Fortran order"),
    ],
)
def test_an_npy_of_another_shape_is_refused(tmp_path: Path, array: Any, message: str) -> None:
    path = write_oneshot(tmp_path).with_suffix(".npy")
    np.save(path, array)
    with pytest.raises(UsageError, match=message):
        read_samples(path)


def test_a_header_that_lies_about_its_size_takes_no_memory(tmp_path: Path) -> None:
    path = write_oneshot(tmp_path).with_suffix(".npy")
    path.write_bytes(path.read_bytes().replace(b"(4, 5), }      ", b"(4000000000, 5)"))
    with pytest.raises(UsageError, match="npy: "):
        read_samples(path)


def test_samples_of_before_other_middlewares_are_of_roscpp(tmp_path: Path) -> None:
    path = write_cyclic(tmp_path)
    record = read_samples(path).record
    assert (record.middleware, record.costs) == ("roscpp", None)
    costs = {"minor_faults": 1, "major_faults": 0, "voluntary_switches": 2, "involuntary_switches": 3}
    change_record(path, middleware="zeromq", costs=costs | {"cpu_time_ns": 1000})
    record = read_samples(path).record
    assert record.middleware == "zeromq" and record.costs and record.costs.cpu_time_ns == 1000


def test_incomplete_samples_miss_what_nobody_knows_of(tmp_path: Path) -> None:
    path = write_communication(tmp_path)
    counts = json.loads(path.read_text())["counts"]
    change_record(path, complete=False, incomplete_reason="the publisher left", counts=counts | {"missing": 0})
    assert read_samples(path).record.counts.missing == 0
    change_record(path, counts=counts | {"missing": 2})
    with pytest.raises(UsageError, match="counts: 5 asked for, but 6 measured"):
        read_samples(path)


def test_times_that_cannot_be_are_refused_not_wrapped_around(tmp_path: Path) -> None:
    path = write_cyclic(tmp_path).with_suffix(".npy")
    np.save(path, np.array([[-(10**18) - 1, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0]], dtype="<i8"))
    with pytest.raises(UsageError, match="a time beyond 1000000000000000000 ns cannot be"):
        read_samples(path)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"schema": 2}, "schema: takes 1, got 2"),
        ({"colour": "red"}, "unknown key 'colour', allowed: schema, suite"),
        ({"suite": "twoshot"}, "suite: unknown suite 'twoshot', known: oneshot_timer_tests"),
        # A baseline is a suite of campaigns, but it writes no samples.
        ({"suite": "cyclictest"}, "suite: unknown suite 'cyclictest', known: oneshot_timer_tests"),
        ({"counts": {"asked": -1}}, "counts.asked"),
        ({"requested": {}}, "requested.frequency_hz: must be a whole number, got None"),
        (
            {"requested": {"frequency_hz": 0}},
            "requested: frequency_hz takes a whole number from 1 to 1000000000",
        ),
    ],
)
def test_a_record_that_breaks_the_format_is_refused(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    path = write_cyclic(tmp_path)
    change_record(path, **changed)
    with pytest.raises(UsageError) as error:
        read_samples(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


@pytest.mark.parametrize(
    "data", [b"", b"[1]", b'{"schema": NaN}', b"\xff\xfe", b"[" * 100_000, b"1" * 5000, b'{"a": ' * 50_000]
)
def test_what_is_no_json_is_refused(tmp_path: Path, data: bytes) -> None:
    path = write_cyclic(tmp_path)
    path.write_bytes(data)
    with pytest.raises(UsageError) as error:
        read_samples(path)
    assert str(error.value).startswith(f"{path}: ")


def test_a_json_too_large_is_refused(tmp_path: Path) -> None:
    path = write_cyclic(tmp_path)
    with path.open("r+b") as stream:
        stream.truncate((16 << 20) + 1)
    with pytest.raises(UsageError, match="larger than 16777216 bytes"):
        read_samples(path)


@pytest.mark.parametrize("ending", [".json", ".npy"])
def test_one_without_the_other_is_refused(tmp_path: Path, ending: str) -> None:
    path = write_cyclic(tmp_path)
    path.with_suffix(ending).unlink()
    with pytest.raises(UsageError, match=rf"{ending}: No such file"):
        read_samples(path)
