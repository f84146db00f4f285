"""Years of cyclictest's histograms of another lab, as OSADL keeps them, become a history with boards and kernels."""

import json
from datetime import datetime, timedelta

import numpy as np
import pytest

from rtrun.cli import main

BOARDS, KERNELS = 5, ("5.15.96-rt61", "6.1.38-rt12", "6.6.30-rt30")
CPUS, LAST_US = 4, 400
SLOWER = 3  # the board on which the last kernel is slower


def histogram_text(rng, mean_us, n=20_000):
    """What `cyclictest -l20000 -m -Sp99 -i200 -h400 -q` prints."""
    values = (mean_us + rng.gamma(2.0, 1.5, (CPUS, n))).astype(int)
    counts = np.array([np.bincount(np.minimum(row, LAST_US), minlength=LAST_US + 1) for row in values])
    lines = ["# /dev/cpu_dma_latency set to 0us", "# Histogram"]
    lines += [f"{us:06d} " + "\t".join(f"{count:06d}" for count in counts[:, us]) for us in range(LAST_US)]
    for name, numbers in (
        ("Total", counts[:, :LAST_US].sum(axis=1)),
        ("Min Latencies", values.min(axis=1)),
        ("Avg Latencies", values.mean(axis=1).astype(int)),
        ("Max Latencies", values.max(axis=1)),
        ("Histogram Overflows", counts[:, LAST_US]),
    ):
        lines.append(f"# {name}: " + " ".join(f"{number:09d}" for number in numbers))
    lines += [
        "# Histogram Overflow at cycle number:",
        *(f"# Thread {cpu}:{' 1' * over}" for cpu, over in enumerate(counts[:, LAST_US])),
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("number", [150, pytest.param(2000, marks=[pytest.mark.slow, pytest.mark.timeout(900)])])
def test_years_of_others(capsys, tmp_path, number):
    rng = np.random.default_rng(33)
    days = number // BOARDS
    for board in range(BOARDS):
        for day in range(days):
            kernel = day * len(KERNELS) // days
            mean_us = (4 + board) * (1.15 if board == SLOWER and kernel == 2 else 1.0) + 0.05 * rng.normal()
            start = f"{datetime(2022, 3, 1, 7, 30) + timedelta(days=2 * day):%Y-%m-%dT%H:%M:%S}"
            path = tmp_path / "lab" / f"rack1-slot{board}" / KERNELS[kernel] / f"{start}.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(histogram_text(rng, mean_us))
    results, archive = str(tmp_path / "results"), str(tmp_path / "archive")
    names = ["--names", "{board}/{kernel}/{start}.txt", "--platform", "hardware", "--results", results]
    assert main(["import", *map(str, sorted((tmp_path / "lab").rglob("*.txt"))), *names]) == 0
    printed = capsys.readouterr().out
    assert f"not known of {number} runs: " in printed and len(printed.splitlines()) == number + 4
    assert main(["archive", "add", results, "--to", archive]) == 0
    assert main(["archive", "compact", archive]) == 0
    capsys.readouterr()
    assert main(["history", archive, "--by", "kernel", "--deadline", "100us", "--json"]) == 0
    points = json.loads(capsys.readouterr().out)["points"]
    pairs = {(point["machine"], point["kernel"]) for point in points}
    assert sum(len(point["run_keys"]) for point in points) == number
    assert sum(point["n"] for point in points) == number * CPUS * 20_000
    assert len(pairs) == BOARDS * len(KERNELS)
    assert main(["trends", archive, "--deadline", "100us", "--json"]) == 0
    changes = json.loads(capsys.readouterr().out)["changes"]
    assert {change["machine"] for change in changes} == {f"rack1-slot{SLOWER}"}
    assert all(change["worse"] for change in changes)
    # Bins of a microsecond move the rarer percentiles by boots; the median is where the kernel was installed.
    (median,) = [change for change in changes if change["figure"] == "p50"]
    assert median["circumstances"] == [f"kernel: {KERNELS[1]} -> {KERNELS[2]}"]


def test_fields_of_names_may_have_what_stands_between_them(capsys, tmp_path):
    """A kernel has a dash; a time ends a name."""
    rng = np.random.default_rng(1)
    for name in ("r1s3-6.6.30-rt30-2024-03-01.txt", "r1s3-6.6.30-rt30-2024-03-01T07:30:00Z.txt"):
        (tmp_path / name).write_text(histogram_text(rng, 5.0, 100))
    files = map(str, tmp_path.glob("*.txt"))
    names = ["--names", "{board}-{kernel}-{start}.txt", "--platform", "hardware", "--results", str(tmp_path / "out")]
    assert main(["import", *files, *names]) == 0
    records = [json.loads(path.read_text()) for path in (tmp_path / "out").glob("*/run.json")]
    assert {(record["target"]["name"], record["target"]["kernel_release"]) for record in records} == {
        ("r1s3", "6.6.30-rt30")
    }
    assert {record["start_time"][:16] for record in records} == {"2024-03-01T00:00", "2024-03-01T07:30"}
