"""The picture of a log: drawn by the real gnuplot, never by obeying the log."""

import subprocess

import pytest
from report.campaigns import cyclic_run, latencies, oneshot_run, write_log

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.cli import main
from rtrun.report.plots import pictures

JPEG = b"\xff\xd8\xff"


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "oneshot_timer_tests_l2000_tm1000-tnRTRR-measured.log"
    write_log(path, "oneshot_timer_tests", latencies(2000, 1), label="Measured:", asked=2000)
    return path


def test_the_picture_has_the_name_of_the_log(log):
    assert pictures.draw_all([log]) == []
    picture = log.with_suffix(".jpg")
    assert picture.read_bytes().startswith(JPEG) and picture.stat().st_size > 10_000
    assert sorted(path.name for path in log.parent.iterdir()) == sorted([log.name, picture.name])
    first = picture.read_bytes()
    picture.unlink()
    pictures.draw(log)
    assert picture.read_bytes() == first


def test_gnuplot_draws_the_log_as_it_is_too(log):
    subprocess.run(["gnuplot", log.name], cwd=log.parent, check=True, capture_output=True)
    assert log.with_suffix(".jpg").read_bytes().startswith(JPEG)


def test_a_picture_newer_than_its_log_is_kept(log):
    picture = log.with_suffix(".jpg")
    picture.write_bytes(b"mine")
    pictures.draw_all([log])
    assert picture.read_bytes() == b"mine"


def test_the_name_of_a_log_is_no_command(log):
    renamed = log.rename(log.with_name("`touch obeyed`'x_oneshot_timer_tests_l2000_tm1000-tnRTRR-measured.log"))
    assert pictures.draw_all([renamed]) == []
    assert renamed.with_suffix(".jpg").read_bytes().startswith(JPEG)
    assert not (log.parent / "obeyed").exists()


def test_a_log_with_commands_is_not_drawn(log):
    log.write_text(log.read_text().replace("set yrange", 'set title "`touch obeyed`"\nset yrange'))
    (trouble,) = pictures.draw_all([log])
    assert "no suite writes the command" in trouble
    assert not (log.parent / "obeyed").exists()


def test_negative_values_are_drawn(tmp_path):
    lateness = latencies(2000, 1)
    lateness[::8] -= 900_000
    folder = cyclic_run(tmp_path, "a", lateness, logs=True)
    (log,) = folder.glob("*.log")
    assert pictures.draw_all([log]) == []
    assert "set xrange [-" in pictures.script(pictures.read_log(log), "x.jpg")


def test_what_is_no_log_is_told_and_the_others_are_drawn(log):
    bad = log.with_name("bad.log")
    bad.write_text("nonsense")
    (trouble,) = pictures.draw_all([bad, log])
    assert "bad.log" in trouble and log.with_suffix(".jpg").exists()
    with pytest.raises(UsageError):
        pictures.draw(bad)


def test_without_gnuplot_the_remedy_is_told(log, monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(InfrastructureError, match="apt-get install gnuplot"):
        pictures.draw(log)
    assert [path.name for path in log.parent.iterdir()] == [log.name]


def test_a_report_needs_no_gnuplot(log, monkeypatch, capsys):
    monkeypatch.setenv("PATH", "/nonexistent")
    assert main(["report", str(log)]) == 0
    printed, errors = capsys.readouterr()
    assert printed.splitlines()[-1].startswith("file://") and "apt-get install gnuplot-nox" in errors


def test_a_report_of_samples_without_logs_draws_nothing(tmp_path):
    folder = oneshot_run(tmp_path, "a", latencies(100, 1))
    assert pictures.draw_all(folder.glob("*.log")) == []
