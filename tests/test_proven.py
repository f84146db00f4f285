"""The example of docs/proven.md is what `rtrun gate` prints, and each part of the answer has its row."""

import re

import pytest
from report.campaigns import cyclic_run, latencies

from pages import TOP
from rtrun.cli import main

PAGE = (TOP / "docs/proven.md").read_text()
SCENARIO = "cyclic_timer FIFO 1000 Hz"


@pytest.fixture
def results(tmp_path):
    """Eight boots of one board, a loop at 1 kHz for 10 s on each, from 08:10 to 10:45."""
    for boot in range(8):
        at = f"2026-11-23T{8 + boot // 3:02}:{10 + 5 * boot:02}"
        cyclic_run(
            tmp_path,
            f"001-cyclic-r{boot + 1}",
            latencies(10_000, seed=100 + boot),
            policy="FIFO",
            hz=1000,
            target={"name": "board", "kernel_release": "6.1.0-rt", "cpus": 2, "boot_id": f"boot-{boot}"},
            start_time=f"{at}:00+00:00",
            end_time=f"{at}:10+00:00",
        )
    return tmp_path


def test_the_example_is_what_the_gate_prints(results, capsys):
    command, shown = re.search(r"^    \$ rtrun (gate RESULTS .+)\n((?:    .+\n)+)", PAGE, re.M).groups()
    assert main([str(results) if word == "RESULTS" else word for word in command.split()]) == 0
    table, reasons = capsys.readouterr().out.split("\n\n")
    assert table.split() == shown.split()
    explained = PAGE.partition("| the answer prints | it means |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = [row.split(" | ")[0].removeprefix("| ") for row in explained.splitlines()]
    assert rows == reasons.strip().removeprefix(f"{SCENARIO}: ").split("; ")
