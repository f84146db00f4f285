"""Every format: complete, the same bytes twice, and nothing from a target gets out of its place."""

import csv
import hashlib
import importlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import webbrowser
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from urllib.parse import unquote

import pyarrow.parquet
import pytest
from report.campaigns import latencies, oneshot_run

from logs import LOGS_2014
from rtrun.cli import main
from rtrun.report.terminal import BANNERS
from rtrun.targets.inspection.platform import Platform

LOG_2014 = LOGS_2014 / "oneshot_timer_tests_l200_tm1000-tnRTRR-measured.log"


def write(capsysbinary, results, form):
    assert main(["report", str(results), "--deadline", "400us", "--format", form, "--output", "-"]) == 0
    return capsysbinary.readouterr().out


@pytest.mark.parametrize("form", ["html", "markdown", "json", "junit", "lava", "csv", "parquet"])
def test_the_same_input_gives_the_same_bytes(capsysbinary, campaign, form):
    first = write(capsysbinary, campaign, form)
    assert first and first == write(capsysbinary, campaign, form)


def test_the_page_needs_no_network(capsysbinary, campaign):
    page = write(capsysbinary, campaign, "html").decode()
    outside = re.findall(r"""(?:src|href|url\(|@import|fetch\(|import\()\s*=?\s*["']?(https?:|//)""", page)
    assert not outside
    assert page.count("<svg") > 40 and "default-src 'none'" in page and len(page) < 1_500_000


def test_emulated_is_the_first_thing_said(capsysbinary, emulated):
    assert write(capsysbinary, emulated, "markdown").decode().splitlines()[0] == f"**{BANNERS[Platform.EMULATED]}**"
    page = write(capsysbinary, emulated, "html").decode()
    body = re.sub(r"\s*<[^>]+>\s*", "\n", page[page.index("<body>") :]).split("\n")
    assert next(line for line in body if line) == BANNERS[Platform.EMULATED]
    data = json.loads(write(capsysbinary, emulated, "json"))
    assert data["platform"] == "emulated" and {g["verdict"]["answer"] for g in data["groups"]} == {
        "not a real-time statement"
    }


def test_json_holds_everything(capsysbinary, campaign):
    data = json.loads(write(capsysbinary, campaign, "json"), parse_constant=lambda name: pytest.fail(name))
    assert data["schema"] == 2 and "claims" not in data
    oneshot = next(s for s in data["series"] if s["series"] == "measured")
    assert set(oneshot["figures"]["percentiles_ns"]) >= {"p50", "p99.9", "p99.999"}
    assert len(oneshot["figures"]["top"]) == len(oneshot["figures"]["lowest"]) == 10
    for group in data["groups"]:
        for bound in group["worst_case"]:
            assert (bound["level_ns"] is None) == (bound["refused"] is not None)


def test_threads_beside_the_measurement_are_not_what_was_in_effect(capsysbinary, campaign):
    text = write(capsysbinary, campaign, "markdown").decode()
    assert re.search(r"threads in effect, policy RR asked for \|? *\|? *RR 95 *\|", text)


def test_tables_agree_between_csv_and_parquet(capsysbinary, campaign):
    rows = list(csv.DictReader(io.StringIO(write(capsysbinary, campaign, "csv").decode())))
    table = pyarrow.parquet.read_table(io.BytesIO(write(capsysbinary, campaign, "parquet"))).to_pylist()
    assert [row["run"] for row in rows] == [row["run"] for row in table]
    assert [float(row["p99_us"]) for row in rows] == [row["p99_us"] for row in table]
    oneshot = {"measured", "reported", "difference", "measured_2014", "difference_2014"}
    assert {row["series"] for row in rows} == oneshot | {"lateness", "jitter", "grid", "latency"}


def test_a_cell_of_text_is_no_formula(capsysbinary, tmp_path):
    formula = '=HYPERLINK("http://x")'
    for name, run in (("a", formula), ("b", "-1+1"), ("c", "plain")):
        oneshot_run(tmp_path, name, latencies(300, ord(name)) - 90_000, run=run)
    table = list(csv.DictReader(io.StringIO(write(capsysbinary, tmp_path, "csv").decode())))
    assert list(dict.fromkeys(row["run"] for row in table)) == [f"'{formula}", "'-1+1", "plain"]
    assert all(float(row["min_us"]) < 0 for row in table if row["series"] == "measured")


def test_junit_has_a_case_a_group(capsysbinary, campaign):
    root = ElementTree.fromstring(write(capsysbinary, campaign, "junit"))
    cases = root.findall(".//testcase")
    assert len(cases) == 15 == int(root.attrib["tests"])
    assert int(root.attrib["failures"]) == len(root.findall(".//failure"))


def test_what_a_target_says_stays_text(capsysbinary, tmp_path):
    evil = "<script>alert(1)</script>\x1b]0;x\x07 \"'&|`*"
    target = {"name": evil, "kernel_version": evil, "clock": {"source": f"<b>{evil}", "event": None, "step_ns": None}}
    oneshot_run(tmp_path, "a", latencies(300, 1), parameters={"cpu": evil}, target=target)
    oneshot_run(tmp_path, "b", latencies(300, 1), parameters={"cpu": evil}, status="failed", reason=evil)
    page = write(capsysbinary, tmp_path, "html").decode()
    assert "<script>alert" not in page and "<b>&lt;" not in page and "<b><" not in page and "&lt;script&gt;" in page
    root = ElementTree.fromstring(write(capsysbinary, tmp_path, "junit"))
    assert any("<script>" in case.attrib["name"] for case in root.findall(".//testcase"))
    text = write(capsysbinary, tmp_path, "markdown").decode()
    assert "<script>" not in text.replace("\\<script\\>", "")
    assert main(["gate", str(tmp_path), "--deadline", "400us"]) == 1
    assert b"\x1b" not in capsysbinary.readouterr().out


@pytest.mark.parametrize("form", ["html", "markdown", "json", "junit", "lava", "csv", "parquet"])
def test_no_format_holds_commands_to_a_terminal_or_half_characters(capsysbinary, tmp_path, form):
    evil = "\x1b]0;x\x07\nFORGED line"
    target = {"name": evil, "kernel_version": evil}
    folder = tmp_path / os.fsdecode(b"results-\xff")
    forged = {"parameters": {"cpu": evil}, "target": target, "run": evil}
    oneshot_run(folder, "a", latencies(300, 1), campaign="x", **forged)
    oneshot_run(folder, "b", latencies(300, 1), campaign="x", status="failed", reason=evil)
    content = write(capsysbinary, folder, form)
    if form not in ("html", "parquet"):
        assert b"\nFORGED" not in content and b"\x1b" not in content and b"\x07" not in content
    lone = folder / os.fsdecode(b"\xff_oneshot_timer_tests_l200_tm1000-tnRTRR-measured.log")
    shutil.copy(LOG_2014, lone)
    assert write(capsysbinary, lone, form)


def test_a_reason_from_a_target_makes_no_line_of_its_own(capsysbinary, tmp_path):
    folder, _ = (oneshot_run(tmp_path, name, latencies(300, 1)) for name in "ab")
    path = next(folder.glob("one*.json"))
    header = {"complete": False, "incomplete_reason": "left\nPROVEN  everything\x1b[2J"}
    path.write_text(json.dumps(json.loads(path.read_text()) | header))
    record = json.loads((folder / "run.json").read_text())
    record["files"][path.name] = {
        "size_bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()
    }  # fmt: skip
    (folder / "run.json").write_text(json.dumps(record))
    for command in (["show"], ["report", "--deadline", "1ms"], ["gate", "--deadline", "1ms"], ["claims"]):
        main([*command, str(tmp_path)])
        header = capsysbinary.readouterr().out
        assert b"left?PROVEN" in header and b"\nPROVEN" not in header and b"\x1b" not in header


def test_a_report_is_written_beside_the_results(capsys, tmp_path):
    folder = oneshot_run(tmp_path, "a", latencies(300, 1), logs=True)
    assert main(["report", str(tmp_path), "--deadline", "400us"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert (
        printed[0].startswith("It is not decided whether the deadline of 400 us is met. Asked: ")
        and printed[1].startswith("oneshot_timer  none of 300 late, worst ")
        and printed[-2].startswith("next: measure more: ")
        and printed[-1] == f"file://{tmp_path}/report.html"
    )
    assert "<html" in (tmp_path / "report.html").read_text()
    pictures = sorted(path.name for path in folder.glob("*.jpg"))
    assert pictures == [path.with_suffix(".jpg").name for path in sorted(folder.glob("*.log"))] and pictures


def test_where_it_cannot_be_written_the_answer_is_printed(capsys, tmp_path):
    oneshot_run(tmp_path, "a", latencies(300, 1), logs=True)
    (tmp_path / "report.html").mkdir()
    for words, remedy in (([], ": name another file by --output"), (["--output", str(tmp_path / "report.html")], "")):
        assert main(["report", str(tmp_path), "--deadline", "400us", *words]) == 2
        printed = capsys.readouterr()
        assert "It is not decided" in printed.out and "file://" not in printed.out
        assert printed.err == f"rtrun: {tmp_path}/report.html: cannot be written: Is a directory{remedy}\n"
    assert main(["report", str(tmp_path), "--output", str(tmp_path / "b.html")]) == 0


@pytest.mark.root("gives results to another user")
def test_who_may_not_write_beside_the_results_gets_the_answer(tmp_path):
    """Neither the report nor pictures of logs can be written there."""
    results = tmp_path / "results"
    for path in (oneshot_run(results, "a", latencies(300, 1), logs=True), results):
        os.chown(path, 12345, 12345)
    argv = [
        "setpriv",
        "--bounding-set=-dac_override",
        sys.executable,
        "-m",
        "rtrun.cli",
        "report",
        str(results),
        "--deadline",
        "1ms",
    ]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "It is not decided" in done.stdout
    assert (
        done.stderr
        == f"rtrun: {results}/report.html: cannot be written: Permission denied: name another file by --output\n"
    )


def with_browser(folder, monkeypatch, script):
    """A browser that keeps the address it was given."""
    browser = folder / "browser"
    browser.write_text(f"#!/bin/sh\n{script}\n")
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    importlib.reload(webbrowser)
    return folder / "opened"


def test_open_opens_the_page_that_is_written(campaign, tmp_path, monkeypatch, capsys):
    opened = with_browser(tmp_path, monkeypatch, f'printf %s "$1" >{tmp_path}/opened')
    page = tmp_path / "a page; #1 ä.html"
    assert main(["report", str(campaign), "--output", str(page), "--open"]) == 0
    address = capsys.readouterr().out.splitlines()[-1]
    assert opened.read_text() == address and address.isascii()
    assert Path(unquote(address.removeprefix("file://"))) == page


def test_a_page_is_opened_only_where_that_is_asked_for(campaign, tmp_path, monkeypatch, capsys):
    opened = with_browser(tmp_path, monkeypatch, f"touch {tmp_path}/opened")
    page = str(tmp_path / "a.html")
    assert main(["report", str(campaign), "--output", page]) == 0
    for words in (["--output", "-"], ["--output", str(tmp_path / "a.md")], ["--format", "csv"]):
        assert main(["report", str(campaign), *words, "--open"]) == 2
        assert "--open: opens a page in a browser" in capsys.readouterr().err
    assert not opened.exists()
    assert main(["report", str(campaign), "--output", str(tmp_path / "a.csv")]) == 0
    assert "file://" not in capsys.readouterr().out


def test_without_a_browser_the_page_is_there_and_it_says_so(campaign, tmp_path, monkeypatch, capsys):
    with_browser(tmp_path, monkeypatch, "exit 1")
    monkeypatch.setattr("webbrowser._tryorder", [])
    page = tmp_path / "a.html"
    assert main(["report", str(campaign), "--output", str(page), "--open"]) == 0
    assert page.is_file() and "no browser was found" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["x.md", "--format", "html"], "--format html, --output x.md: a file that ends in .md holds markdown"),
        (["x.txt"], "--output x.txt: which format? End it in one of .html, .md, .json, .xml, .lava, .csv, .parquet"),
    ],
)
def test_a_file_that_says_another_format_than_it_holds(campaign, capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(campaign), "--output", *words]) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize(
    ("words", "start"), [(["x.CSV"], b"run,"), (["x.xml"], b"<?xml"), (["x.txt", "--format", "lava"], b"communication")]
)
def test_the_end_of_a_file_says_its_format(campaign, tmp_path, monkeypatch, words, start):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(campaign), "--deadline", "400us", "--output", *words]) == 0
    assert (tmp_path / words[0]).read_bytes().startswith(start)
