"""Changes in an archive: when, how much and why; builds held against it; the version to measure next."""

import json

import pytest
from archive.archived import N, write_build, write_course
from report.campaigns import latencies, oneshot_run, write_run

from rtrun.archive import NO_DEADLINE
from rtrun.cli import main
from rtrun.targets.inspection.platform import Platform

DAYS = 30
CHANGED = 18  # the day from which on something is another


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    return write_course(tmp_path_factory.mktemp("steady") / "archive", [100.0] * DAYS)


@pytest.fixture(scope="module")
def slower(tmp_path_factory):
    """From one day on 10 % slower, with another kernel and commit, and hotter."""
    levels = [100.0] * CHANGED + [110.0] * (DAYS - CHANGED)
    facts = [
        {
            "kernel": "6.1" if day < CHANGED else "6.6",
            "commit": f"c{day}",
            "packages": {"roscpp": "1.16" if day < CHANGED else "1.17", "same": "1"},
            "temperature_mc": 45_000 + 200 * (day % 3) + (9000 if day >= CHANGED else 0),
        }
        for day in range(DAYS)
    ]
    return write_course(tmp_path_factory.mktemp("slower") / "archive", levels, facts=facts)


def changes(capsys, archive):
    assert main(["trends", str(archive), "--deadline", "400us", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["changes"]


def test_a_steady_course_has_no_change(capsys, steady):
    assert changes(capsys, steady) == []


def test_a_change_is_told_with_when_how_much_and_what_changed_there(capsys, slower):
    by_figure = {change["figure"]: change for change in changes(capsys, slower)}
    assert by_figure.keys() == {"p50", "p99"}  # 4000 values a run are too few for p99.9
    for change in by_figure.values():
        assert change["worse"]
        assert change["index_boot"] == CHANGED
        assert change["last_before"] == "2026-01-18T10:00:00Z"
        assert change["first_after"] == "2026-01-19T10:00:00Z"
        assert change["earliest"] <= change["first_after"] <= change["latest"]
        assert 8_000 < change["low"] < change["high"] < 12_000
        circumstances = change["circumstances"]
        assert {"kernel: 6.1 -> 6.6", "package roscpp: 1.16 -> 1.17"} <= set(circumstances)
        assert any(text.startswith("commit: c1") for text in circumstances)
        assert any(text.startswith("temperature: 45.2 -> 54.2") for text in circumstances)
        assert not any("same" in text or "roscpp version" in text for text in circumstances)


@pytest.mark.parametrize(
    ("kernels", "expected"),
    [
        (("6.6.30", "6.1.0", "6.6.30", "6.1.0"), set()),  # in turn all the time: no circumstance of a change
        (("6.6.30", "6.1.0", "6.1.0", "6.1.0"), {"kernel: 6.1.0 and 6.6.30 in turn -> 6.1.0"}),
        (("6.1.0", "6.1.0", "6.6.30", "6.6.30"), {"kernel: 6.1.0 -> 6.6.30"}),
    ],
)
def test_kernels_that_are_measured_in_turn_are_no_change(capsys, tmp_path, kernels, expected):
    """What an even and an odd day had before the change and after it."""
    facts = [{"kernel": kernels[2 * (day >= CHANGED) + day % 2], "commit": f"c{day}"} for day in range(DAYS)]
    levels = [100.0] * CHANGED + [110.0] * (DAYS - CHANGED)
    for change in changes(capsys, write_course(tmp_path / "archive", levels, facts=facts)):
        circumstances = change["circumstances"]
        assert {text for text in circumstances if text.startswith("kernel")} == expected
        assert any(text.startswith("commit: c1") for text in circumstances)


def test_a_change_is_told_in_words(capsys, slower):
    assert main(["trends", str(slower)]) == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "2 changes in 1 course, of 30 boots"
    assert lines[0].startswith("WORSE  oneshot_timer RR 1000 us on board: p50 ")
    assert "when: between 2026-01-18 10:00 and 2026-01-19 10:00" in lines[1]


def test_misses_change_too(capsys, tmp_path):
    archive = write_course(tmp_path / "archive", [100.0] * DAYS, late=[0] * CHANGED + [3] * (DAYS - CHANGED))
    (change,) = changes(capsys, archive)
    assert (change["figure"], change["index_boot"], change["before"]) == ("P(miss)", CHANGED, 0)
    assert change["after"] == pytest.approx(3 / 4000)


def test_a_short_run_takes_no_figure_from_the_longer_ones(capsys, tmp_path):
    """A quick try of the same scenario, which is too short for a p99."""
    levels = [100.0] * CHANGED + [110.0] * (DAYS - CHANGED)
    archive = write_course(tmp_path / "archive", levels, lengths=[1000] + [N] * (DAYS - 1))
    assert {change["figure"] for change in changes(capsys, archive)} == {"p50", "p99"}
    status, output = gate(capsys, write_build(tmp_path / "results", 125.0, 125.0), archive)
    assert status == 1 and "; p99 " in output


def gate(capsys, results, archive, *words):
    status = main(["gate", str(results), "--against", str(archive), *words])
    output = capsys.readouterr()
    return status, output.out + output.err


def test_a_build_as_good_as_its_history_passes(capsys, steady, tmp_path):
    status, output = gate(capsys, write_build(tmp_path / "results", 101.0), steady)
    assert (status, output.splitlines()[0]) == (0, "passed")
    assert "NOT WORSE" in output


@pytest.mark.parametrize(("levels", "answer", "advice"), [
    ((125.0,), "PERHAPS WORSE", "this may be one bad boot: measure a second boot"),
    ((125.0, 125.0), "WORSE", ""),
    ((160.0, 100.0), "PERHAPS WORSE", "the worst of its 2 boots alone: measure another boot"),
    ((130.0, 100.0, 100.0, 100.0), "NOT WORSE", ""),
])  # fmt: skip
def test_a_build_is_worse_when_not_one_boot_alone_is(capsys, steady, tmp_path, levels, answer, advice):
    status, output = gate(capsys, write_build(tmp_path / "results", *levels), steady, "--junit", str(tmp_path / "xml"))
    assert (status, output.splitlines()[0]) == ((0, "passed") if answer == "NOT WORSE" else (1, "failed"))
    assert f"  {answer}  " in output and advice in output and "best level of 30 boots" in output
    assert "noticed nine times in ten from 1" in output
    assert f'type="{answer}"' in (tmp_path / "xml").read_text() or status == 0


def test_a_margin_that_is_given_counts(capsys, steady, tmp_path):
    results = write_build(tmp_path / "results", 125.0, 125.0)
    assert gate(capsys, results, steady, "--margin", "40us")[0] == 0


@pytest.mark.parametrize(("boots", "answer"), [(1, "PERHAPS WORSE"), (2, "WORSE")])
def test_a_build_that_misses_more_fails(capsys, steady, tmp_path, boots, answer):
    results = write_build(tmp_path / "results", *[100.0] * boots, late=10)
    assert gate(capsys, results, steady)[0] == 0, "without a deadline"
    status, output = gate(capsys, results, steady, "--deadline", "400us")
    assert status == 1 and f"  {answer}  " in output
    assert "P(miss) 0.0025, best level of 30 boots 0, limit " in output


def test_the_goal_of_the_results_is_the_question(capsys, steady, tmp_path):
    """Without one, and without a deadline, quantiles alone are compared, and a line tells how to ask."""
    results = write_build(tmp_path / "results", 100.0, 100.0, late=10)
    status, output = gate(capsys, results, steady)
    assert status == 0 and "P(miss) 0" not in output and NO_DEADLINE in output
    goal = {"deadline": "400us", "probability": 1e-3, "at_most": "1h"}
    (results / "goal.json").write_text(json.dumps({"schema": 1, "until": goal}))
    status, output = gate(capsys, results, steady)
    assert status == 1 and "  WORSE  " in output and "P(miss) 0.0025" in output and NO_DEADLINE not in output


def test_what_got_worse_before_is_no_measure_for_a_build(capsys, slower, tmp_path):
    """Twelve boots of the slower level do not make it the one that counts."""
    status, output = gate(capsys, write_build(tmp_path / "results", 120.0), slower, "--margin", "3us")
    assert status == 1 and f"best level of {CHANGED} boots" in output


def test_runs_that_are_in_the_archive_already_are_not_their_own_history(capsys, tmp_path):
    archive = write_course(tmp_path / "archive", [100.0] * 4)
    results = write_build(tmp_path / "results", 100.0)
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    capsys.readouterr()
    status, output = gate(capsys, results, archive)
    assert status == 1 and "NO HISTORY" in output and "4 boots of it are in the archive, 5 are needed" in output


def test_suites_with_the_same_parameters_have_courses_of_their_own(capsys, tmp_path):
    write_course(tmp_path / "archive", [100.0] * 8)
    archive = write_course(tmp_path / "archive", [300.0] * 8, suite="other_timer_tests", seed=2)
    status, output = gate(capsys, write_build(tmp_path / "results", 100.0), archive)
    assert status == 0, output
    assert "best level of 8 boots 100" in output


def test_a_build_with_a_run_that_failed_does_not_pass(capsys, steady, tmp_path):
    results = write_build(tmp_path / "results", 100.0)
    record = {"status": "failed", "reason": "the suite ended with status 1", "start_time": "2027-01-01T10:00:00Z"}
    parameters = {"policy": "RR", "timeout_us": 1000, "busy_mode": 0}
    write_run(results, "002-oneshot", "oneshot_timer_tests", [], parameters, asked=10, logs=False, **record)
    status, output = gate(capsys, results, steady)
    assert status == 1
    assert "002-oneshot" in output and "NOT ANALYSED" in output and "failed: the suite ended with status 1" in output


def test_runs_that_count_allocations_are_in_no_history(capsys, tmp_path):
    """Counting is in their times."""
    archive = write_course(tmp_path / "archive", [100.0] * 8)
    results = write_build(tmp_path / "results", 100.0)
    counting = {"parameters": {"allocations": "counted"}, "start_time": "2027-01-01T11:00:00Z"}
    oneshot_run(results, "009-counting", latencies(N, 1, 900.0), target={"name": "board"}, **counting)
    assert gate(capsys, results, archive)[0] == 0
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    capsys.readouterr()
    assert main(["history", str(archive), "--json"]) == 0
    assert "allocations" not in capsys.readouterr().out


def test_a_build_without_times_does_not_pass(capsys, steady, tmp_path):
    """An imported log has none, so it has no place in a course."""
    oneshot_run(tmp_path / "results", "000-x", latencies(N, 1), start_time="unknown")
    status, output = gate(capsys, tmp_path / "results", steady)
    assert status == 1 and "000-x" in output and "it has no start time" in output


@pytest.mark.parametrize(("platform", "words", "expected"), [
    ("virtual", (), 1),
    ("virtual", ("--platform", "virtual"), 0),
    ("emulated", ("--platform", "virtual"), 1),
])  # fmt: skip
def test_platforms_pass_as_with_a_deadline(capsys, tmp_path, platform, words, expected):
    archive = write_course(tmp_path / "archive", [100.0] * 8, platform=Platform(platform))
    results = write_build(tmp_path / "results", 100.0, platform=platform)
    assert gate(capsys, results, archive, *words)[0] == expected


def test_options_of_the_other_question_are_refused(capsys, steady, tmp_path):
    results = write_build(tmp_path / "results", 100.0)
    assert gate(capsys, results, steady, "--probability", "1e-6")[0] == 2
    assert main(["gate", str(results), "--margin", "5us"]) == 2


def test_bisect_names_the_commit_in_the_middle(capsys, tmp_path):
    """Commits a to z, of which a, h and z are measured, in an order that is not theirs; from k on it is worse."""
    letters = [chr(ord("a") + k) for k in range(26)]
    measured = ["a"] * 5 + ["z"] * 6 + ["h"] * 5
    archive = write_course(
        tmp_path / "archive",
        [110.0 if letter >= "k" else 100.0 for letter in measured],
        facts=[{"commit": letter} for letter in measured],
    )
    order = tmp_path / "order"
    order.write_text("\n".join(letters) + "\n")
    assert main(["bisect", str(archive), "--order", str(order)]) == 0
    output = capsys.readouterr().out
    assert "oneshot_timer RR 1000 us on board: p50 got worse between h and z" in output
    assert "measure q: 17 between them are not measured" in output


def test_bisect_ends_at_the_first_version_that_is_worse(capsys, tmp_path):
    versions = ["1.9"] * 6 + ["1.10"] * 6
    archive = write_course(
        tmp_path / "archive",
        [100.0] * 6 + [112.0] * 6,
        facts=[{"packages": {"roscpp": version}} for version in versions],
    )
    order = tmp_path / "order"
    order.write_text("1.9\n1.10\n1.11\n")
    assert main(["bisect", str(archive), "--by", "package roscpp", "--order", str(order)]) == 0
    assert "    1.10 is the first one that is worse" in capsys.readouterr().out.splitlines()
    order.write_text("2.0\n")
    assert main(["bisect", str(archive), "--by", "package roscpp", "--order", str(order)]) == 2
    assert "1 line, but no package roscpp of a run in " in capsys.readouterr().err


def test_bisect_of_a_steady_course(capsys, steady, tmp_path):
    order = tmp_path / "order"
    order.write_text("6.1\n6.6\n")
    assert main(["bisect", str(steady), "--by", "kernel", "--order", str(order)]) == 0
    assert capsys.readouterr().out == "nothing got worse, as far as these versions are measured\n"
