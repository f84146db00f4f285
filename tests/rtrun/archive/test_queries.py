"""Figures from an archive are those of a report on the same runs."""

import json

import pyarrow.compute
import pyarrow.parquet
import pytest
from archive.examples import answer_of, expected_answer, write_days, write_mixture
from report.campaigns import (
    cyclic_rows,
    cyclic_run,
    latencies,
    oneshot_run,
    write_campaign,
    write_log_alone,
)

from rtrun.analysis.figures import PERCENTILES
from rtrun.archive import bins, queries
from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS

STEP_NS = 16  # of the clock of the campaigns


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("results") / "board", n=3000)


def history(capsys, archive, *words):
    assert main(["history", str(archive), "--json", "--deadline", "400us", *words]) == 0
    return json.loads(capsys.readouterr().out)["points"]


def archived(capsys, results, archive, *words):
    assert main(["archive", "add", str(results), "--to", str(archive), *words]) == 0
    capsys.readouterr()
    return archive


def test_figures_are_those_of_the_report(capsys, campaign, tmp_path):
    points = history(capsys, archived(capsys, campaign, tmp_path / "archive"), "--by", "run")
    analysed = study(campaign, THESIS, bounds=False)
    groups = {group.label: group for group in analysed.groups}
    assert {point["scenario"] for point in points} == groups.keys()
    compared = 0
    for point in points:
        group = groups[point["scenario"]]
        surely = group.verdict.misses - sum(run.unclear for run in group.account.runs)
        assert (point["n"], point["misses"] - point["unclear"]) == (group.verdict.n, surely)
        if len(group.digests) > 1:
            continue  # a report pools subscribers to the width of a bin
        (digest,) = group.digests
        assert point["max_ns"] == digest.figures.max_ns // STEP_NS * STEP_NS
        for p in PERCENTILES:
            assert point["percentiles_ns"][f"p{p:g}"] == digest.figures.percentiles_ns[p] // STEP_NS * STEP_NS
            compared += 1
    assert compared >= 80


def test_subscribers_are_pooled(capsys, campaign, tmp_path):
    points = history(capsys, archived(capsys, campaign, tmp_path / "archive"), "--by", "run")
    groups = {group.label: group for group in study(campaign, bounds=False).groups if len(group.digests) > 1}
    assert groups
    for point in points:
        if point["scenario"] in groups:
            group = groups[point["scenario"]]
            assert point["n"] == group.n
            assert point["max_ns"] == max(digest.figures.max_ns for digest in group.digests) // STEP_NS * STEP_NS


def test_the_course_by_time_kernel_board_and_commit(capsys, tmp_path):
    archive = tmp_path / "archive"
    for day in range(4):
        results = tmp_path / f"results-{day}"
        write_days(tmp_path / "all", 4) if day == 0 else None
        results.mkdir()
        (tmp_path / "all" / f"{day:03d}-oneshot").rename(results / f"{day:03d}-oneshot")
        archived(capsys, results, archive, "--commit", f"c{day // 2}")
    labels = {
        by: [(point["label"], point["machine"], point["kernel"]) for point in history(capsys, archive, "--by", by)]
        for by in ("day", "kernel", "board", "commit", "month")
    }
    runs = [("board-0", "6.0"), ("board-0", "6.1"), ("board-1", "6.0"), ("board-1", "6.1")]
    days = ["2026-10-01", "2026-11-01", "2026-10-02", "2026-11-02"]
    assert labels["day"] == [(day, *run) for day, run in zip(days, runs, strict=True)]
    assert labels["month"] == [(day[:7], *run) for day, run in zip(days, runs, strict=True)]
    assert labels["commit"] == [(f"c{k % 2}", *run) for k, run in enumerate(runs)]
    assert labels["board"] == [(machine, machine, kernel) for machine, kernel in runs]
    assert labels["kernel"] == [
        (kernel, machine, kernel) for machine, kernel in sorted(runs, key=lambda run: run[::-1])
    ]
    assert {(point["n"], point["misses"], point["boots"]) for point in history(capsys, archive)} == {(500, 1, 1)}


def test_runs_of_a_point_are_pooled_by_their_counts(capsys, tmp_path):
    root = tmp_path / "results"
    for k, mean_us in enumerate((90.0, 190.0)):
        oneshot_run(root, f"{k}", latencies(1000, k, mean_us, 0.5))
    (point,) = history(capsys, archived(capsys, root, tmp_path / "archive"))
    assert (point["n"], len(point["run_keys"])) == (2000, 2)
    assert 89_000 < point["percentiles_ns"]["p50"] < 95_000 < 185_000 < point["percentiles_ns"]["p90"]


def test_an_outlier_far_away_is_added_up_as_all_others_are(capsys, tmp_path, monkeypatch):
    """Of few histograms, and beyond a number of places, bins are sorted instead."""
    archive = archived(capsys, write_days(tmp_path / "results", 6), tmp_path / "archive")
    answers = []
    for most, lowest in ((10**6, 1), (4, 1), (0, 1), (4, 99)):
        monkeypatch.setattr(bins, "_GRID_MAX", most)
        monkeypatch.setattr(bins, "_GRID_FROM", lowest)
        answers.append(history(capsys, archive, "--by", "month"))
    assert answers[0] and all(answer == answers[0] for answer in answers)


def test_groups_are_read_and_computed_in_several_threads_where_they_are_large(capsys, tmp_path, monkeypatch):
    archive = archived(capsys, write_days(tmp_path / "results", 4), tmp_path / "archive")
    points = history(capsys, archive, "--by", "run")
    threads = []
    monkeypatch.setattr(queries.os, "cpu_count", lambda: 3)
    monkeypatch.setattr(queries, "_LARGE", 0)
    pool = queries.ThreadPoolExecutor
    monkeypatch.setattr(queries, "ThreadPoolExecutor", lambda number: threads.append(number) or pool(number))
    assert history(capsys, archive, "--by", "run") == points and threads == [3]


def test_what_a_histogram_does_not_reach_is_not_known(capsys, tmp_path):
    text = ["# Histogram", *(f"{value:06d} {10 if value < 99 else 5:06d}" for value in range(90, 100))]
    text += ["# Min Latencies: 00090", "# Avg Latencies: 00103", "# Max Latencies: 00700"]
    text += ["# Histogram Overflows: 00003", "# Histogram Overflow at cycle number:", "# Thread 0: 1 2 3"]
    (tmp_path / "hist.txt").write_text("\n".join(text) + "\n")
    assert (
        main(["import", str(tmp_path / "hist.txt"), "--results", str(tmp_path / "results"), "--platform", "hardware"])
        == 0
    )
    archive = archived(capsys, tmp_path / "results", tmp_path / "archive")
    (point,) = history(capsys, archive, "--deadline", "95us")
    assert (point["n"], point["label"], point["max_ns"]) == (98, "unknown", None)
    assert point["percentiles_ns"]["p50"] == 94_000
    assert point["percentiles_ns"]["p99"] is None
    assert point["misses"] == 48 and point["unclear"] == 10  # 96 us and above, and the bin that begins at 95 us
    (beyond,) = history(capsys, archive, "--deadline", "400us")
    assert beyond["misses"] is None


def test_duckdb_by_itself_gives_the_same_numbers(capsys, tmp_path):
    """The other programs of docs/archive.md: `make test-archive`."""
    archive = archived(capsys, write_mixture(tmp_path / "results"), tmp_path / "archive")
    points = [*history(capsys, archive), *history(capsys, archive, "--of", "jitter")]
    assert answer_of("duckdb", archive) == expected_answer(points)


def write_timer(root, name, day):
    """A run of a cyclic timer on a boot of its own, ten calls of which are late in a row."""
    late = latencies(3000, day)
    late[1000:1010] += 1_000_000
    target = {"name": "board", "kernel_release": "6.1", "boot_id": f"boot-{day}"}
    return cyclic_run(root, name, late, hz=1000, start_time=f"2026-10-{day:02d}T10:00:00Z", target=target)


def test_lateness_and_jitter_have_histories_of_their_own(capsys, tmp_path):
    for day in range(1, 7):
        write_timer(tmp_path / "results", f"{day}", day)
    archive = archived(capsys, tmp_path / "results", tmp_path / "archive")
    for words, scenario, misses in (((), "", 10), (("--of", "jitter"), ", jitter", 1)):
        points = history(capsys, archive, "--by", "run", *words)
        assert {point["scenario"] for point in points} == {f"cyclic_timer RR 1000 Hz{scenario}"}
        assert [point["misses"] for point in points] == [misses] * 6
    write_timer(tmp_path / "build", "new", 20)
    gate = ("gate", str(tmp_path / "build"), "--against", str(archive))
    assert main([*gate]) == main([*gate, "--of", "jitter"]) == 0
    capsys.readouterr()
    # A log of 2014 holds the jitter alone.
    write_log_alone(tmp_path / "2014", "log", "cyclic_timer_tests", cyclic_rows(latencies(3000, 9), 1000),
                    {"policy": "RR", "frequency_hz": 1000}, asked=3000,
                    target={"name": "board", "kernel_release": "6.1", "boot_id": "boot-1"})  # fmt: skip
    both = archived(capsys, tmp_path / "2014", archived(capsys, tmp_path / "results", tmp_path / "both"))
    assert sorted((p["series"], len(p["run_keys"])) for p in history(capsys, both, "--by", "kernel")) == [
        ("jitter", 1), ("lateness", 6)
    ]  # fmt: skip
    # Of runs of before the archive has the jitter alone: no lateness is held against it.
    for path in (archive / "histograms").rglob("*.parquet"):
        table = pyarrow.parquet.read_table(path)
        pyarrow.parquet.write_table(table.filter(pyarrow.compute.equal(table["series"], "jitter")), path)
    assert {point["series"] for point in history(capsys, archive)} == {"jitter"}
    assert history(capsys, archive, "--of", "lateness") == []
    assert main([*gate]) == 1
    assert "0 boots of it are in the archive" in capsys.readouterr().out
    assert main([*gate, "--of", "jitter"]) == 0
    oneshot_run(tmp_path / "other", "a", latencies(500, 1))
    assert main(["gate", str(tmp_path / "other"), "--against", str(archive), "--of", "jitter"]) == 1
    assert "NOT ANALYSED" in (out := capsys.readouterr().out) and "it has no jitter" in out
