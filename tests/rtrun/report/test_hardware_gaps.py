"""What hwlatdetect found, in the report of the campaign that it was measured in."""

from pathlib import Path

import pytest
from report.campaigns import latencies, oneshot_run, write_record

from rtrun.cli import main

DATA = Path(__file__).parents[2] / "data/unreadable/hwlatdetect.txt"
NONE = "Max Latency: Below threshold\nSamples recorded: 0\nSamples exceeding threshold: 0\n"


def search(root, name, text, **record):
    folder = root / name
    folder.mkdir()
    (folder / "hwlatdetect.stdout").write_text(text)
    write_record(folder, "hwlatdetect", [], {"duration_s": 10, "threshold_us": 10}, campaign="another", **record)


@pytest.mark.parametrize(
    ("texts", "outcome"),
    [
        ([NONE], "none found in 1 run"),
        ([NONE, DATA.read_text()], "the longest 14 us, in 1 of 2 runs"),
    ],
)
def test_gaps_are_shown_next_to_the_values(tmp_path, capsys, texts, outcome):
    root = tmp_path / "runs"
    oneshot_run(root, "loop", latencies(500, 1))
    for number, text in enumerate(texts):
        search(root, f"gaps-{number}", text)
    search(root, "failed", DATA.read_text().replace("14us", "15us"), status="failed", reason="it ended")
    assert main(["report", str(root), "--output", "-", "--format", "markdown"]) == 0
    section = capsys.readouterr().out.partition("## Gaps of the hardware")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in section.splitlines() if line.startswith("| gaps-")
    ]
    assert outcome in section and [row[3:5] for row in rows] == [["10 s", "10 us"]] * len(texts)
    assert [row[5:] for row in rows] == [["0", "-"], ["1", "14 us"]][: len(texts)]


def test_without_such_a_run_nothing_is_said(tmp_path, capsys):
    oneshot_run(tmp_path / "runs", "loop", latencies(500, 1))
    assert main(["report", str(tmp_path / "runs"), "--output", "-", "--format", "markdown"]) == 0
    assert "Gaps of the hardware" not in capsys.readouterr().out
