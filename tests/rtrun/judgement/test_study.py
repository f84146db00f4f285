"""From run directories to groups and verdicts, and what is refused on the way."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from report.campaigns import (
    bursty,
    cyclic_rows,
    cyclic_run,
    latencies,
    message_run,
    oneshot_run,
    write_log_alone,
    write_run,
)

from rtfiles.errors import UsageError
from rtrun.analysis.deadline import Answer
from rtrun.analysis.figures import IndexedValue
from rtrun.judgement.study import study
from rtrun.judgement.verdicts import verdict_line
from rtrun.plan.question import THESIS, read_tolerance
from rtrun.targets.inspection.platform import Platform


def only(path, **question):
    (group,) = study(path, replace(THESIS, **question)).groups
    return group


def test_runs_alike_are_one_group(tmp_path):
    for k in range(3):
        oneshot_run(tmp_path, f"{k}", latencies(1000 * (k + 1), k), logs=True)
    # An option that the program did not have when the other runs were measured, not given.
    record = json.loads((tmp_path / "0" / "run.json").read_text())
    record["parameters"]["cpu_dma_latency_us"] = None
    (tmp_path / "0" / "run.json").write_text(json.dumps(record))
    group = only(tmp_path)
    assert group.runs == ("0", "1", "2") and group.n == 6000
    assert group.verdict is not None and group.verdict.n == 6000


@pytest.mark.parametrize("other", [{"name": "board", "kernel_release": "6.6"}, {"name": "another"}])
def test_runs_on_another_board_or_kernel_are_another_group(tmp_path, other):
    oneshot_run(tmp_path, "a", latencies(1000, 1), logs=True)
    oneshot_run(tmp_path, "b", latencies(1000, 2), target=other, logs=True)
    assert [group.n for group in study(tmp_path, THESIS).groups] == [1000, 1000]


def test_enough_measurements_prove_a_deadline(tmp_path):
    oneshot_run(tmp_path, "a", latencies(5000, 1))
    assert verdict_line(only(tmp_path, probability=1e-3, bursts=1)).answer == Answer.PROVEN
    line = verdict_line(only(tmp_path, probability=1e-6, bursts=1))
    assert line.answer == Answer.NEEDS_MORE and "(1 h 10 min)" in line.text
    assert verdict_line(only(tmp_path, deadline_ns=90_000)).answer == Answer.REFUTED


def test_misses_within_10_ms_are_one_episode(tmp_path):
    values = latencies(5000, 1)
    values[[100, 105, 3000]] = 500_000
    oneshot_run(tmp_path, "a", values)
    episodes = only(tmp_path, probability=1e-3).verdict.episodes
    assert (episodes.seen, episodes.longest_misses, episodes.longest_ns) == (2, 2, 6 * 1_150_000)


def test_bursts_make_measurements_worth_less(tmp_path):
    oneshot_run(tmp_path, "a", bursty(8000, 1))
    verdict = only(tmp_path, deadline_ns=110_000).verdict
    assert verdict is not None and verdict.design_effect > 3 and verdict.n_effective < 3000


def test_a_timer_that_never_fired_missed_its_deadline(tmp_path):
    values = latencies(2000, 1)
    values[[3, 77]] = -(2**63)
    oneshot_run(tmp_path, "a", values)
    group = only(tmp_path)
    assert group.verdict is not None and (group.verdict.n, group.verdict.late, group.verdict.absent) == (2000, 0, 2)
    assert "2 never came" in verdict_line(group).text
    assert group.digests[0].figures.n == 1998


def test_the_first_message_stands_apart_and_lost_ones_count(tmp_path):
    values = latencies(1000, 1, 220.0)
    values[0] = 900_000
    message_run(tmp_path, "a", [values], lost=(5, 6, 7))
    group = only(tmp_path)
    (digest,) = group.digests
    assert (
        digest.header.startup == (IndexedValue(value_ns=900_000, index=0),)
        and digest.n == 996
        and digest.header.missing == 3
    )
    assert group.verdict is not None and (group.verdict.n, group.verdict.late, group.verdict.absent) == (999, 0, 3)
    assert "start-up apart: 1 late, worst 900 us" in verdict_line(group).text
    assert digest.figures.top[0].index is not None and digest.figures.top[0].index > 0


def test_the_two_definitions_of_jitter_and_the_cluster(tmp_path):
    lateness = latencies(4000, 1)
    lateness[::8] -= 900_000
    cyclic_run(tmp_path, "a", lateness)
    analysed = study(tmp_path, replace(THESIS, of="jitter"))
    (jitter,) = analysed.digests
    grid = next(digest for digest in analysed.others if digest.header.series == "grid")
    assert jitter.cluster is not None and jitter.cluster.fraction == pytest.approx(1 / 8, abs=0.002)
    assert grid.cluster is not None and grid.cluster.fraction == pytest.approx(1 / 8, abs=0.002)
    assert grid.cluster.median_ns == pytest.approx(-810_000, abs=5000)
    assert len(jitter.header.startup) == 2


CYCLIC = {"policy": "RR", "frequency_hz": 100}


def asked(path, **question):
    (group,) = study(path, replace(THESIS, **question)).groups
    return group


def test_ten_late_calls_in_a_row_are_ten_misses_of_the_grid(tmp_path):
    late = latencies(4000, 1)
    late[2000:2010] += 1_000_000
    cyclic_run(tmp_path, "a", late)
    by_grid, by_jitter = asked(tmp_path), asked(tmp_path, of="jitter")
    assert (by_grid.series, by_grid.verdict.misses, by_grid.label) == ("lateness", 10, "cyclic_timer RR 100 Hz")
    assert (by_jitter.series, by_jitter.label) == ("jitter", "cyclic_timer jitter RR 100 Hz")
    assert by_jitter.verdict.misses <= 2
    assert "P(lateness > 400 us) " in verdict_line(by_grid).text
    assert "P(jitter > 400 us) " in verdict_line(by_jitter).text
    assert [group.series for group in study(tmp_path, THESIS).as_in_2014] == ["jitter"]
    # Nine of the ten follow on a miss, eight on two: those end more than 1 and more than 2 in a row.
    for tolerance, misses in (("1 in a row", 9), ("2 in a row", 8), ("10 in a row", 0), ("4 of 100", 5 + 95 - 4 + 5)):
        group = asked(tmp_path, tolerance=read_tolerance(tolerance))
        assert (group.verdict.misses, group.verdict.n) == (misses, 3998 - read_tolerance(tolerance).among + 1)
        assert f"P(more than {tolerance} with lateness > 400 us) " in verdict_line(group).text


def test_the_jitter_of_a_log_is_not_pooled_with_the_lateness_of_samples(tmp_path):
    values = latencies(500, 1)
    cyclic_run(tmp_path, "new", values)
    write_log_alone(tmp_path, "2014", "cyclic_timer_tests", cyclic_rows(values, 100), CYCLIC, asked=500)
    groups = study(tmp_path, THESIS).groups
    assert {(group.series, group.runs) for group in groups} == {("lateness", ("new",)), ("jitter", ("2014",))}


def test_skipped_periods_are_misses_and_stay_in_the_run(tmp_path):
    rows = cyclic_rows(latencies(4000, 1), 100)
    rows[2000:] += 5 * 10_000_000
    rows[[*range(1000, 1010), -1], 0] += 20_000_000  # interrupted between the two stamps of a call
    write_run(tmp_path, "a", "cyclic_timer_tests", [rows], CYCLIC, asked=4000, logs=False)
    group = asked(tmp_path)
    assert (group.verdict.n, group.verdict.late, group.verdict.absent) == (4003, 0, 5)
    assert "0 of 4 003 late and 5 periods skipped" in verdict_line(group).text
    assert group.digests[0].header.skipped == 5 and group.digests[0].loops == 4005


def test_no_answer_rests_on_a_grid_that_jumped_with_the_clock(tmp_path):
    rows = cyclic_rows(latencies(4000, 1), 100)
    rows[2000:, 1:] += 3_600 * 10**9
    write_run(tmp_path, "a", "cyclic_timer_tests", [rows], CYCLIC, asked=4000, logs=False)
    group = asked(tmp_path)
    assert group.verdict is None
    assert "the wall clock, by which the timer keeps its grid, was set by 3.6e+06 ms" in verdict_line(group).text
    assert asked(tmp_path, of="jitter").verdict.misses == 0


def test_a_question_of_what_was_not_measured_is_refused(tmp_path):
    oneshot_run(tmp_path / "both", "a", latencies(500, 1), logs=True)
    with pytest.raises(UsageError, match=r"both: oneshot_timer_tests measures latency, not jitter$"):
        study(tmp_path / "both", replace(THESIS, of="jitter"))
    assert asked(tmp_path / "both", of="lateness").verdict.question.of == "latency"
    cyclic_run(tmp_path / "both", "b", latencies(500, 1))
    analysed = study(tmp_path / "both", replace(THESIS, of="jitter"))
    assert [group.series for group in analysed.groups] == ["jitter"]
    (text,) = analysed.left_out
    assert text.endswith("oneshot_timer_tests measures latency, not jitter")


def test_five_subscribers_are_one_group_whose_messages_count_once(tmp_path):
    message_run(tmp_path, "a", [latencies(1000, k) for k in range(5)])
    group = only(tmp_path)
    assert len(group.digests) == 5 and len(group.blocks) == 1
    assert group.verdict is not None and group.verdict.n_effective == pytest.approx(999, rel=0.01)


def test_an_emulated_board_gets_no_verdict_and_no_worst_case(emulated):
    analysed = study(emulated, THESIS)
    assert analysed.platform is Platform.EMULATED
    assert {verdict_line(group).answer for group in analysed.groups} == {Answer.NO_STATEMENT}
    assert all(not group.bounds and group.no_bound == "measured on an emulated board" for group in analysed.groups)


def test_what_cannot_be_analysed_is_told_and_the_rest_is(tmp_path):
    oneshot_run(tmp_path, "good", latencies(500, 1), logs=True)
    oneshot_run(tmp_path, "failed", latencies(500, 2), status="failed", reason="the board rebooted", logs=True)
    cut = oneshot_run(tmp_path, "cut", latencies(500, 3), logs=True)
    data = next(cut.glob("*.npy"))
    data.write_bytes(data.read_bytes()[:-8])
    (tmp_path / "open").mkdir()
    analysed = study(tmp_path, THESIS)
    assert [group.runs for group in analysed.groups] == [("good",)]
    left_out = "\n".join(analysed.left_out)
    assert "failed: failed: the board rebooted" in left_out
    assert "altered since the run was closed" in left_out and ".npy" in left_out
    assert "open: incomplete" in left_out


def test_logs_alone_are_read_as_histograms(tmp_path):
    folder = oneshot_run(tmp_path, "a", latencies(3000, 1), logs=True)
    log = next(folder.glob("*.log"))
    alone = tmp_path / log.name
    shutil.copy(log, alone)
    group = only(alone, probability=0.01)
    assert group.n == 3000 and group.verdict is not None and group.verdict.assumes
    assert group.no_bound is not None and "no order" in group.no_bound


def test_a_lone_npy_is_read_with_its_json(tmp_path):
    folder = oneshot_run(tmp_path, "a", latencies(3000, 1), logs=True)
    assert only(next(folder.glob("*.npy"))).n == 3000
    assert only(folder).n == 3000


@pytest.mark.parametrize("values", [np.full(500, 70_000), np.array([5_000]), -latencies(400, 1), np.full(300, 10**13)])
def test_odd_series_are_reported_like_others(tmp_path, values):
    """All equal, one sample, negative only, values of hours."""
    oneshot_run(tmp_path, "a", values.astype(np.int64))
    group = only(tmp_path)
    assert group.n == values.size and all(bound.refused for bound in group.bounds)


def test_all_missing_is_a_miss_each_time(tmp_path):
    oneshot_run(tmp_path, "a", np.full(100, -(2**63)))
    group = only(tmp_path)
    assert group.n == 0 and group.verdict is not None and group.verdict.absent == 100
    assert verdict_line(group).answer == Answer.REFUTED


def test_nothing_to_examine_is_an_error(tmp_path):
    for path, message in ((tmp_path / "none", "no such file"), (tmp_path, "no finished run")):
        with pytest.raises(UsageError, match=message):
            study(path, THESIS)
    (tmp_path / "x.txt").write_text("x")
    with pytest.raises(UsageError, match="not a run directory, a folder of runs"):
        study(tmp_path / "x.txt", THESIS)


def test_a_record_with_names_that_leave_the_folder_is_refused(tmp_path):
    folder = oneshot_run(tmp_path, "a", latencies(100, 1), logs=True)
    oneshot_run(tmp_path, "b", latencies(100, 1), logs=True)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"outputs": ["../b/x"]}))
    analysed = study(tmp_path, THESIS)
    assert len(analysed.groups) == 1 and "no name of a file" in analysed.left_out[0]
