"""The static pages about an archive, and the figures for Grafana."""

import json
import re
from datetime import UTC, datetime

import pytest
from archive.archived import write_course

from rtrun.cli import main

EVIL = "<script>missing()</script>"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    facts = [{"commit": EVIL if day else "c0", "kernel": "6.1" if day < 8 else "6.6"} for day in range(16)]
    archive = write_course(folder / "archive", [100.0] * 8 + [120.0] * 8, facts=facts)
    assert main(["site", str(archive), "--output", str(folder / "pages")]) == 0
    return folder / "pages"


def test_the_front_page_has_the_state_of_every_scenario(site):
    page = (site / "index.html").read_text()
    assert "Of 1 scenario 1 got worse." in page
    assert "✗ WORSE: p50, p99" in page
    (link,) = re.findall(r'<a href="([0-9a-f]{16}\.html)">oneshot_timer RR 1000 us on board</a>', page)
    assert (site / link).is_file()


def test_the_page_of_a_scenario_has_its_course(site):
    (path,) = [path for path in site.glob("*.html") if path.name != "index.html"]
    page = path.read_text()
    plots = [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    *lines, deadline, change, _ = plots[0]["marks"]
    assert [line["name"] for line in lines] == ["p50", "p99", "p99.9", "p99.99", "max"]
    assert {len(line["x"]) for line in lines} == {32}
    assert (deadline["name"], deadline["y"]) == ("deadline 400 us", [400_000, 400_000])
    assert change["name"] == "p50 worse" and change["x"] == [datetime(2026, 1, 9, 10, tzinfo=UTC).timestamp()] * 2
    assert "kernel: 6.1 -&gt; 6.6" in page
    assert page.count("<tr>") == 1 + 32
    assert EVIL not in page and "&lt;script&gt;missing()" in page


def test_figures_for_grafana(site):
    text = (site / "metrics.txt").read_text()
    *lines, end, rest = text.split("\n")
    assert (end, rest) == ("# EOF", "")
    samples = [line for line in lines if not line.startswith("# ")]
    form = re.compile(r'[a-z_]+\{([a-z_]+="[^"]*",?)+\} [0-9.e-]+')
    assert samples and all(form.fullmatch(line) for line in samples)
    (p50,) = [line for line in samples if 'percentile="50"' in line]
    assert 1.1e-4 < float(p50.split()[-1]) < 1.3e-4
    assert 'machine="board",platform="hardware",kernel="6.6"' in p50
    (start,) = [line for line in samples if line.startswith("rtrun_run_start_time_seconds")]
    assert start.endswith(f" {datetime(2026, 1, 16, 11, tzinfo=UTC).timestamp():.0f}")
    names = {line.partition("{")[0] for line in samples}
    assert {line.split()[2] for line in lines if line.startswith("# TYPE ")} == names
    dashboard = json.loads((site / "grafana-dashboard.json").read_text())
    asked = {panel["targets"][0]["expr"].partition("{")[0].split()[-1] for panel in dashboard["panels"]}
    assert asked <= names


def test_an_archive_without_times_has_no_site(capsys, tmp_path):
    (tmp_path / "empty").mkdir()
    assert main(["site", str(tmp_path / "empty"), "--output", str(tmp_path / "pages")]) == 2
    assert not (tmp_path / "pages").exists()
