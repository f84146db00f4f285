"""`rtrun show` on real outputs and on run directories, whole, unfinished and tampered with."""

import json
import math
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written import write_communication, write_cyclic, write_oneshot, write_output, write_record

from logs import LOGS_2014, SUITES
from rtfiles.errors import UsageError
from rtrun.analysis.figures import Figures, figures_of_samples
from rtrun.cli import main
from rtrun.results.gnuplot_log import read_log
from rtrun.results.reading import read_run
from rtrun.results.samples import read_samples
from rtrun.results.series import SampleSeries, Series, read_file

COMMUNICATION = {"policy": "RR", "repetitions": 100, "frequency_hz": 1000, "payload_bytes": 0}


def show(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    status = main(["show", *map(str, arguments)])
    return status, *capsys.readouterr()


def show_json(capsys: pytest.CaptureFixture[str], path: Path) -> dict[str, Any]:
    status, output, _ = show(capsys, path, "--json")
    assert status == 0

    def refuse(name: str) -> None:
        pytest.fail(f"{name} in the JSON")

    data = json.loads(output, parse_constant=refuse)
    assert isinstance(data, dict)
    return data


def communication_run(folder: Path, **changed: Any) -> Path:
    """A run directory of two real subscribers."""
    folder.mkdir(parents=True)
    outputs = [f"{k}ct_gnuplot_l100_fq1000_pl0-tnRTRR" for k in (0, 1)]
    for output in outputs:
        for path in SUITES.glob(f"{output}.*"):
            shutil.copy(path, folder)
    write_record(folder, "communication_tests", outputs, COMMUNICATION | {"subscribers": 2}, **changed)
    return folder


def with_startup(series: Series) -> Figures:
    """Figures of all values, as the suites themselves print them."""
    assert isinstance(series, SampleSeries)
    startup = series.header.startup
    return figures_of_samples(
        np.array([*(value.value_ns for value in startup), *series.values_ns], dtype=np.int64),
        np.array([*(value.index for value in startup), *series.index], dtype=np.int64),
    )


def test_the_figures_of_real_samples_are_those_their_program_wrote() -> None:
    paths = sorted(SUITES.glob("*.npy"))
    assert len(paths) == 8
    for path in paths:
        summary = read_samples(path).record.summary
        for series in read_file(path):
            ours, theirs = with_startup(series), summary[series.header.series]
            assert (ours.n, ours.min_ns, ours.max_ns) == (theirs.n, theirs.min_ns, theirs.max_ns)
            assert ours.mean_ns == (None if theirs.mean_ns is None else pytest.approx(theirs.mean_ns, abs=0.6))
            for list_, their_list in ((ours.top, theirs.top), (ours.lowest, theirs.lowest)):
                assert [(e.value_ns, e.index) for e in list_] == [(e.value_ns, e.index) for e in their_list]


def test_the_logs_of_real_samples_say_the_same_in_whole_microseconds() -> None:
    for path in SUITES.glob("*.log"):
        log = read_log(path)
        name = path.stem
        for ending in ("-measured", "-reported", "-diff"):
            name = name.removesuffix(ending)
        samples = SUITES / f"{name}.npy"
        figures = next(with_startup(series) for series in read_file(samples) if series.header.series == log.series)
        assert (log.remarks, log.incomplete) == ((), None if figures.n else "nothing came for 1 s, no message came")
        assert (int(log.count.sum()), log.missing) == (figures.n, read_samples(samples).record.counts.missing)
        if log.series not in ("reported", "difference_2014"):
            for ours, exact in ((log.top, figures.top), (log.lowest, figures.lowest)):
                # Jitter is rounded down, latencies towards zero.
                rounded = math.floor if log.series == "jitter" else int
                assert [e.value_ns // 1000 for e in ours] == [rounded(e.value_ns / 1000) for e in exact]
                assert sorted(e.index or 0 for e in ours) == sorted(e.index or 0 for e in exact)


def test_show_and_report_say_the_same_and_which_values_stand_apart(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = tmp_path / "demo" / "001-run"
    run.mkdir(parents=True)
    rows = [(1000 * k, 1000 * k + (900_000 if k == 0 else 270_000 - k), k) for k in range(50)]
    name = "ct_gnuplot_l50_fq100_pl0-tnRTRR"
    requested = {"repetitions": 50, "frequency_hz": 100, "payload_bytes": 0}
    write_output(run, name, "communication_tests", rows, requested=requested, asked=50, measured=50)
    write_record(run, "communication_tests", [name], COMMUNICATION)
    (shown,) = show_json(capsys, run)["results"]
    assert (shown["n"], shown["max_us"], shown["startup"]) == (49, 269.999, [{"value_us": 900, "index": 0}])
    assert "latency start-up apart, in no figure: 900 us (loop 0)" in show(capsys, run)[1]
    assert main(["report", str(run), "--format", "json", "--output", "-"]) == 0
    (reported,) = json.loads(capsys.readouterr().out)["series"]
    assert reported["startup"] == [{"value_ns": 900_000, "index": 0}]
    for key in ("min", "max", "mean"):
        assert shown[f"{key}_us"] == pytest.approx(reported["figures"][f"{key}_ns"] / 1000)
    assert reported["figures"]["percentiles_ns"]["p99"] == 1000 * shown["p99_us"]


def test_a_start_up_value_that_a_log_lists_stands_apart_in_its_figures(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = SUITES / "0ct_gnuplot_l100_fq1000_pl0-tnRTRR.log"
    of_log, of_samples = show_json(capsys, path), show_json(capsys, path.with_suffix(".npy"))["results"][0]
    assert (of_log["n"], of_samples["n"]) == (99, 99)
    assert of_log["max_us"] == of_samples["max_us"] // 1
    assert [value["index"] for value in of_log["startup"]] == [0]
    assert 0 not in [value["index"] for value in of_log["top"]]


def test_a_log_as_json_holds_the_figures_at_the_top(capsys: pytest.CaptureFixture[str]) -> None:
    data = show_json(capsys, LOGS_2014 / "oneshot_timer_tests_l200_tm1000-tnRTRR-measured.log")
    assert {key: data[key] for key in ("n", "min_us", "max_us", "missing", "out_of_order")} == {
        "n": 200, "min_us": 14, "max_us": 273, "missing": 0, "out_of_order": 0,
    }  # fmt: skip
    assert data["mean_us"] == pytest.approx(42.48)
    assert data["top"][0] == {"value_us": 273, "index": 33}
    assert data["lowest"][0] == {"value_us": 14, "index": 122}


def test_a_log_is_a_plain_table_when_not_on_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    status, output, _ = show(capsys, LOGS_2014 / "late_ct_gnuplot_l300_fq100_pl0.log")
    assert status == 0
    assert "\x1b" not in output
    assert re.search(r"communication +OTHER 100Hz 0B +199 +46 +93 +1355 +143 +1355 +101 +0", output)
    assert "late_ct_gnuplot_l300_fq100_pl0: 101 missing messages stand in the log as -1 us" in output
    assert "EMULATED" not in output


@pytest.mark.parametrize("ending", [".npy", ".json"])
def test_samples_show_every_series(capsys: pytest.CaptureFixture[str], tmp_path: Path, ending: str) -> None:
    path = write_oneshot(tmp_path).with_suffix(ending)
    status, output, _ = show(capsys, path)
    assert status == 0
    assert re.search(r"oneshot_timer +RR 1000us +3 +0\.1 +36\.7 +60\.0 +60\.0 +60\.0 +0 +0", output)
    assert re.search(r"oneshot_timer difference +RR 1000us +3 +-0\.5 +5\.0 +8\.0", output)
    assert ": 1 timer did not fire, it is in no figure" in output
    results = show_json(capsys, path)["results"]
    series = ["measured", "reported", "difference", "measured_2014", "difference_2014"]
    assert [result["series"] for result in results] == series
    assert results[0]["not_fired"] == 1


def test_a_run_has_a_row_for_each_subscriber(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = communication_run(tmp_path / "001-run")
    status, output, _ = show(capsys, run)
    assert status == 0
    rows = [line for line in output.splitlines() if line.startswith("communication")]
    assert [re.search(r"RR 1000Hz 0B 2sub #[01] +99 ", row) is not None for row in rows] == [True, True]
    data = show_json(capsys, run)
    assert data["platform"] == "hardware"
    assert [result["output"][:3] for result in data["results"]] == ["0ct", "1ct"]


def test_an_emulated_run_says_so_in_the_first_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = communication_run(tmp_path / "demo" / "001-run", platform="emulated")
    for path in (run, run.parent):
        _, output, _ = show(capsys, path)
        assert output.splitlines()[0] == "EMULATED: not a real-time statement"
        assert show_json(capsys, path)["platform"] == "emulated"


def test_a_run_without_its_record_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run = communication_run(tmp_path / "001-run")
    (run / "run.json").unlink()
    status, output, error = show(capsys, run)
    assert (status, output) == (2, "")
    assert error == f"rtrun: {run}: incomplete run, it has no run.json: nothing in it is analysed, run it again\n"


def test_a_folder_of_runs_lists_what_it_does_not_analyse(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    communication_run(tmp_path / "001-run")
    (communication_run(tmp_path / "002-run") / "run.json").unlink()
    communication_run(tmp_path / "003-run", status="failed", reason="the publisher ended with exit status 1")
    communication_run(tmp_path / "001-run.old-1")
    (tmp_path / ".004-run.partial").mkdir()
    status, output, _ = show(capsys, tmp_path)
    assert status == 0
    assert sum(line.startswith("communication") for line in output.splitlines()) == 2
    assert "003-run: failed: the publisher ended with exit status 1" in output
    assert "002-run: incomplete: it has no run.json, nothing in it is analysed" in output
    assert "partial" not in output
    data = show_json(capsys, tmp_path)
    assert data["incomplete"] == ["002-run"]
    assert [(run["run"], run["status"], len(run["results"])) for run in data["runs"]] == [
        ("001-run", "ok", 2),
        ("003-run", "failed", 0),
    ]


def test_a_damaged_run_hides_no_other_and_ends_with_2(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    communication_run(tmp_path / "001-run")
    damaged = communication_run(tmp_path / "002-run") / "1ct_gnuplot_l100_fq1000_pl0-tnRTRR.npy"
    data = bytearray(damaged.read_bytes())
    data[-1] ^= 1
    damaged.write_bytes(data)
    status, output, error = show(capsys, tmp_path)
    assert status == 2
    assert sum(line.startswith("communication") for line in output.splitlines()) == 2
    assert error.startswith(f"rtrun: {damaged}: altered since the run was closed")


def test_a_folder_with_no_run_says_where_some_are(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    communication_run(tmp_path / "results" / "demo" / "001-run")
    status, _, error = show(capsys, tmp_path / "results")
    assert status == 2
    assert error == (
        f"rtrun: {tmp_path}/results: no finished run (one with run.json) in it, give {tmp_path}/results/demo\n"
    )


def test_a_run_of_the_programs_of_2014_is_read_from_its_logs(tmp_path: Path) -> None:
    output = "oneshot_timer_tests_l200_tm1000-tnRTRR"
    shutil.copy(LOGS_2014 / f"{output}-measured.log", tmp_path)
    write_record(tmp_path, "oneshot_timer_tests", [output], {"policy": "RR", "repetitions": 200, "timeout_us": 1000})
    (result,) = read_run(tmp_path).results
    assert (result.header.series, result.figures.n, result.header.output) == ("measured_2014", 200, output)


def test_a_run_with_no_output_of_a_program_is_refused(tmp_path: Path) -> None:
    write_record(tmp_path, "cyclic_timer_tests", ["cyclic_timer_tests_l3_fq7"], {})
    with pytest.raises(UsageError, match=r"neither samples nor log of the output 'cyclic_timer_tests_l3_fq7'"):
        read_run(tmp_path)


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "..", "a/../../b", "a\0b", ""])
def test_a_name_that_leads_out_of_the_run_is_refused(tmp_path: Path, name: str) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write_cyclic(tmp_path)
    digest = {"size_bytes": 1, "sha256": "0" * 64}
    write_record(run, "cyclic_timer_tests", [], {}, files={name: digest})
    with pytest.raises(UsageError, match=r"run\.json: "):
        read_run(run)
    write_record(run, "cyclic_timer_tests", [name], {}, files={f"{name}.npy": digest, f"{name}.json": digest})
    with pytest.raises(UsageError, match=r"run\.json: "):
        read_run(run)


def test_a_link_out_of_the_run_is_not_followed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    path = write_cyclic(tmp_path)
    for ending in (".json", ".npy"):
        (run / path.with_suffix(ending).name).symlink_to(path.with_suffix(ending))
    write_record(run, "cyclic_timer_tests", [path.stem], {})
    with pytest.raises(UsageError, match=r"npy: named in run\.json, but no such file"):
        read_run(run)


def test_a_run_of_another_suite_than_its_output_is_refused(tmp_path: Path) -> None:
    path = write_communication(tmp_path)
    write_record(tmp_path, "cyclic_timer_tests", [path.stem], {})
    with pytest.raises(UsageError, match=r"of communication_tests, but run\.json says cyclic_timer_tests"):
        read_run(tmp_path)


@pytest.mark.parametrize("name", ["nothing.log", "nothing", "nothing.npy"])
def test_what_is_not_there_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    status, output, error = show(capsys, tmp_path / name)
    assert (status, output) == (2, "")
    assert "o such file" in error


def test_what_is_no_result_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "campaign.yml"
    path.write_text("schema: 1\n")
    status, _, error = show(capsys, path)
    assert status == 2
    assert error == f"rtrun: {path}: not a run directory, a folder of runs, or a .log, .npy or .json of a suite\n"


def test_more_missing_messages_than_memory_holds_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = write_communication(tmp_path)
    record = json.loads(path.read_text())
    record["counts"] |= {"asked": 100_000_000, "missing": 100_000_000 - 4}
    path.write_text(json.dumps(record))
    status, _, error = show(capsys, path)
    assert status == 2 and "100000000 were asked for, 4 came: none with more than 10000000 missing is read" in error


def test_a_pipe_beside_a_json_is_refused_at_once(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = write_communication(tmp_path)
    path.with_suffix(".npy").unlink()
    os.mkfifo(path.with_suffix(".npy"))
    status, _, error = show(capsys, path)
    assert status == 2 and error.endswith(".npy: not a regular file\n")
