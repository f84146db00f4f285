"""`results/latest`: who sets it, who takes it, and when it is not followed."""

import json
import os
from pathlib import Path

import pytest
from report.campaigns import write_campaign
from traced import specimen, write_traced_run

from logs import LOGS_2014
from rtrun.cli import main
from rtrun.results.latest import LINK, latest_results, set_latest

LOG = "oneshot_timer_tests_l50_tm2000-measured.log"
NOBODY = 12345


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two campaigns in a working directory of their own, the newest called brakes."""
    monkeypatch.chdir(tmp_path)
    tmp_path.chmod(0o755)
    for name in ("arm", "brakes"):
        write_campaign(tmp_path / "results" / name, n=300)
    set_latest(Path("results/brakes"))
    return tmp_path / "results"


@pytest.mark.parametrize("command", ["report", "verdict", "show", "why"])
def test_without_a_folder_the_newest_is_taken_and_named(
    results: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command]) == 0
    alone = capsys.readouterr()
    assert alone.err.startswith("rtrun: results/brakes, the newest (results/latest)\n")
    assert main([command, "results/brakes"]) == 0
    assert capsys.readouterr().out == alone.out


def test_the_report_is_written_where_it_says(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report"]) == 0
    assert "results/brakes/report.html" in capsys.readouterr().out
    assert (results / "brakes" / "report.html").is_file()


def test_traces_of_the_newest_explain_it(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_traced_run(results / "traced", {1558: specimen(1558)}, [23166, 23175])
    set_latest(Path("results/traced"))
    assert main(["why", "-q"]) == 0
    printed = capsys.readouterr()
    assert "1558" in printed.out or "outlier" in printed.out
    assert printed.err == ""


def test_an_import_is_the_newest(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "missing.log", "--platform", "hardware"]) == 2
    assert LINK.readlink() == Path("brakes")
    assert main(["import", str(LOGS_2014 / LOG), "--platform", "hardware", "--results", "results/2014"]) == 0
    assert LINK.readlink() == Path("2014")
    assert main(["show"]) == 0
    assert "results/2014, the newest" in capsys.readouterr().err


def test_only_folders_directly_in_results_are_the_newest(results: Path, tmp_path: Path) -> None:
    for elsewhere in (tmp_path / "elsewhere", results / "arm" / "below", tmp_path):
        elsewhere.mkdir(exist_ok=True)
        set_latest(elsewhere)
        assert latest_results() == Path("results/brakes")
    set_latest(results / "arm")
    assert latest_results() == Path("results/arm")
    set_latest(Path("results/latest"))
    assert latest_results() == Path("results/arm"), "it does not lead to itself"


def test_two_at_once_set_it_whole(results: Path) -> None:
    """Each call replaces the link in one step: it never dangles, and nothing is left behind."""
    children = []
    for name in ("arm", "brakes") * 4:
        if (pid := os.fork()) == 0:
            try:
                for _ in range(50):
                    set_latest(Path("results") / name)
                    latest_results()
            except BaseException:
                os._exit(1)
            os._exit(0)
        children.append(pid)
    assert [os.waitpid(pid, 0)[1] for pid in children] == [0] * 8
    assert sorted(path.name for path in results.iterdir()) == ["arm", "brakes", "latest"]


def test_results_without_the_link_are_listed(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    LINK.unlink()
    assert main(["report"]) == 2
    error = capsys.readouterr().err
    assert error == (
        "rtrun: results/latest: no such link, which whatever measures makes: name the results; those here are "
        "results/arm, results/brakes\n"
    )


def test_a_folder_of_folders_names_each_once(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verdict", "results"]) == 2
    assert capsys.readouterr().err.endswith("give results/arm or results/brakes\n")


def test_a_campaign_called_latest_is_refused(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("c.yml").write_text("schema: 1\nname: latest\nruns: [{suite: cyclic_timer_tests}]\n")
    assert main(["run", "c.yml", "--collect-only"]) == 2
    assert "name another folder by --results" in capsys.readouterr().err


def test_a_folder_of_that_name_stays(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    LINK.unlink()
    write_campaign(results / "latest", n=300)
    set_latest(Path("results/brakes"))
    assert not LINK.is_symlink() and main(["show"]) == 2


def started(folder: Path, day: str, campaign: str = "brakes") -> None:
    """Let all runs of a folder have been started on a day."""
    for path in folder.glob("*/run.json"):
        data = json.loads(path.read_text())
        start, end = (f"{day}T{hour}:00:00+00:00" if day else "unknown" for hour in (10, 11))
        data |= {"campaign": campaign, "start_time": start, "end_time": end}
        path.write_text(json.dumps(data))


@pytest.fixture
def history(results: Path) -> Path:
    """Five folders: brakes were measured on three days, the newest of them the second time; arm in between."""
    for name, day in {
        "first": "2026-11-02",
        "zero": "2026-11-01",
        "brakes": "2026-11-04",
        "later": "2026-11-05",
    }.items():
        if name != "brakes":
            write_campaign(results / name, n=300, seed=len(name))
        started(results / name, day)
    started(results / "arm", "2026-11-03", "arm")
    (results / "a-note").touch()
    (results / "empty").mkdir()
    (results / "same").symlink_to("brakes")
    return results


def test_the_newest_is_compared_with_the_time_before(history: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "--with-last"]) == 0
    compared = capsys.readouterr().out.splitlines()
    assert compared[0] == "A: results/first, B: results/brakes"
    assert main(["compare", "results/first", "results/brakes"]) == 0
    assert capsys.readouterr().out.splitlines() == compared[1:]


def test_a_named_folder_is_compared_with_the_time_before_it(
    history: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for named, before in {"later": "brakes", "first": "zero"}.items():
        assert main(["compare", f"results/{named}", "--with-last"]) == 0
        assert capsys.readouterr().out.startswith(f"A: results/{before}, B: results/{named}\n")
    assert main(["compare", "results/zero", "--with-last"]) == 2
    assert "the campaign brakes was not measured before" in capsys.readouterr().err
    assert main(["compare", "results/zero", "--with-last", "--json"]) == 2
    assert capsys.readouterr().out == ""
    started(history / "brakes", "")
    assert main(["compare", "--with-last"]) == 2
    assert "when it was measured is not known" in capsys.readouterr().err


def test_with_last_takes_one_folder(history: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more in (["results/arm", "results/brakes"], ["--by", "kernel"], ["--sides", "a", "b"]):
        assert main(["compare", "--with-last", *more]) == 2
        assert "--with-last: goes with one folder at most" in capsys.readouterr().err


@pytest.mark.root("gives a folder to another user")
def test_what_another_user_put_next_to_it_is_no_time_before(history: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.chown(history / "first", NOBODY, NOBODY)
    assert main(["compare", "--with-last"]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and "12345: name the results that you mean" in shown.err


@pytest.mark.parametrize("to", ["/", "..", ".", "../elsewhere", "latest", "other", "missing", "a-file", "brakes/001-x"])
def test_what_does_not_lead_to_a_folder_beside_it_is_not_followed(
    results: Path, tmp_path: Path, to: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_campaign(tmp_path / "elsewhere", n=300)
    (results / "other").symlink_to("../elsewhere")
    (results / "a-file").touch()
    LINK.unlink()
    LINK.symlink_to(to)
    assert main(["report"]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.startswith("rtrun: results/latest: ")
    assert not list(tmp_path.rglob("report.html"))


@pytest.mark.root("gives a link to another user")
@pytest.mark.parametrize("of_another", ["link", "folder", "results"])
def test_what_another_user_placed_is_not_followed(
    results: Path, of_another: str, capsys: pytest.CaptureFixture[str]
) -> None:
    place = {"link": LINK, "folder": results / "brakes", "results": results}[of_another]
    os.chown(place, NOBODY, NOBODY, follow_symlinks=False)
    assert main(["verdict"]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and "12345: name the results that you mean" in shown.err


def test_a_link_that_cannot_be_set_is_told(
    results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted", "results/latest")

    monkeypatch.setattr("rtfiles.atomic.replace_link", refuse)
    set_latest(Path("results/arm"))
    assert capsys.readouterr().err == "rtrun: results/latest: not set to arm: Operation not permitted\n"
