"""What tracing costs: traced runs held against their untraced twins, in `rtrun why`, in the report and by `compare`."""

import re

import pytest
from report.campaigns import at_minute, cyclic_run, latencies

from rtrun.cli import main


def write_pairs(root, *, cost_us, pairs=5, twins=True):
    """Pairs of an untraced run and a traced one whose jitter is wider; each traced one has a limit of its own."""
    for number in range(pairs):
        for place, trace in enumerate(("off", "p99.9") if twins else ("p99.9",)):
            lateness = latencies(4000, 2 * number + place, spread_us=8 + place * cost_us)
            minute = 2 * number + place
            limit = {"trace_threshold_us": 40 + number if place or not twins else None}
            record = {"parameters": limit, "trace": trace, **at_minute(minute)}
            cyclic_run(root, f"{minute:03}-{trace}", lateness, policy="0", **record)
    return root


@pytest.mark.parametrize(
    ("cost_us", "outcome"),
    [
        (6, "What tracing costs: tracing shifts values in 1 of 1 scenarios"),
        (0, "What tracing costs: no shift by tracing is seen: an interval says how large it may be"),
    ],
)
def test_why_prints_the_cost_beside(tmp_path, capsys, cost_us, outcome):
    assert main(["why", str(write_pairs(tmp_path / "runs", cost_us=cost_us))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "Traced is what is above p99.9 of the values before: 40 us to 44 us in 5 runs" in lines
    assert outcome in lines
    row = next(line for line in lines if " p99 " in line)
    shown = re.findall(r"([+-]?[0-9.]+) (ns|us)\b", row)[:3]
    untraced, traced, difference = (float(number) / {"ns": 1000, "us": 1}[unit] for number, unit in shown)
    assert difference == pytest.approx(traced - untraced, abs=0.11)
    assert (difference > 5) is bool(cost_us)


def test_the_report_has_the_same_table(tmp_path, capsys):
    root = write_pairs(tmp_path / "runs", cost_us=6, pairs=1)
    assert main(["report", str(root), "--output", "-", "--format", "markdown"]) == 0
    out = capsys.readouterr().out
    assert "## What tracing costs" in out
    assert (
        "these traced runs differ from the untraced in 1 of 1 scenarios; whether tracing shifts values takes five"
        in out
    )
    assert "assumes runs alike: with 1 and 1 of them the difference between them is not in the intervals" in out


def test_without_twins_nothing_is_said_of_it(tmp_path, capsys):
    root = write_pairs(tmp_path / "runs", cost_us=6, twins=False)
    assert main(["why", str(root)]) == 0
    assert "What tracing costs" not in capsys.readouterr().out


def test_traced_and_untraced_runs_are_no_runs_of_one_kind(tmp_path, capsys):
    root = write_pairs(tmp_path / "runs", cost_us=6)
    assert main(["compare", str(root), "--by", "trace"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "A: off, B: p99.9"
    assert out[1].startswith("DIFFERENT  cyclic_timer OTHER 100 Hz")
