"""The static pages about an archive, and the figures for Grafana."""

import html
import itertools
import json
import math
import re
from datetime import UTC, datetime
from pathlib import Path
from unittest import mock

import pytest
from archive.archived import write_course
from hypothesis import given, strategies
from report.test_browser import browse

from rtrun.analysis.comparison.history import LEAST_BOOTS
from rtrun.analysis.order.change_points import LEAST_UNITS
from rtrun.archive import NO_DEADLINE
from rtrun.archive.pictures import _scale
from rtrun.archive.states import HISTORY
from rtrun.cli import main
from rtrun.report.plots.axes import times

LONG = "the-board-with-a-rather-long-name-on-the-upper-shelf"
EVIL = "<script>missing()</script>"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    facts = [{"commit": EVIL if day else "c0" * 20, "kernel": "6.1" if day < 8 else "6.6"} for day in range(16)]
    archive = write_course(folder / "archive", [100.0] * 8 + [120.0] * 8, facts=facts)
    assert main(["site", str(archive), "--output", str(folder / "pages"), "--deadline", "400us"]) == 0
    return folder / "pages"


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """Three boards, each measured on two kernels through two middlewares, one of them in two scenarios."""
    folder = tmp_path_factory.mktemp("boards")
    kernels = [{"kernel": "6.6.30" if day < 8 else "6.12<b>rt</b>"} for day in range(16)]
    scenarios = [("rclcpp", "RR"), ("rclcpp", "FIFO"), ("roscpp", "RR")]
    for seed, (machine, (middleware, policy)) in enumerate(itertools.product(("panda-1", "panda-2", LONG), scenarios)):
        levels = [100.0] * 16
        if (machine, middleware, policy) == ("panda-2", "rclcpp", "FIFO"):
            levels[8:] = [125.0] * 8
        parameters = {"middleware": middleware, "policy": policy}
        with mock.patch("os.fsync"):
            write_course(
                folder / "archive", levels, facts=kernels, machine=machine, seed=100 + seed, parameters=parameters
            )
    assert main(["site", str(folder / "archive"), "--output", str(folder / "pages")]) == 0
    return folder / "pages"


def test_the_front_page_has_the_state_of_every_scenario(site):
    page = (site / "index.html").read_text()
    assert "Of 1 scenario 1 got worse." in page
    assert "✗&nbsp;WORSE: p50, p99" in page
    (link,) = re.findall(r'<a href="([0-9a-f]{16}\.html)">oneshot_timer RR 1000 us on board</a>', page)
    assert (site / link).is_file()


def test_boards_kernels_and_middlewares_are_on_one_page(boards):
    """A board that got worse through one of two middlewares stands first, and has a row for each of its kernels."""
    page = (boards / "boards.html").read_text()
    assert (
        "✗ Something got worse on 1 of 3 boards</p>" in page
        and 'href="boards.html"' in (boards / "index.html").read_text()
    )
    table = page.partition('class="boards"')[2]
    rows = [re.findall(r"<b>(.*?)</b>", row) + row.split("<td")[1:] for row in table.split("<tr")[2:]]
    assert [row[0] for row in rows] == ["panda-2", "panda-2", "panda-1", "panda-1", LONG, LONG]
    newest, past = rows[:2]
    assert re.findall(r'class="(\w+)" data-column="(\w+)"', page)[:2] == [("refuted", "rclcpp"), ("proven", "roscpp")]
    assert "✗ WORSE, 1 of 2 scenarios" in newest[1] and "p99 1" in newest[1] and "✓ STEADY, 1 scenario<" in newest[2]
    assert "until 2026-01-08, 2 scenarios" in past[1] and 'class="none"' in past[1]
    (link,) = re.findall(r'href="(\w+\.html)"', newest[1])
    assert "WORSE: p50, p99" in (boards / link).read_text()
    # The line of the newer kernel ends where the whole one does, and is above where that begins.
    whole, own = (
        [[*map(float, point.split())] for point in path.split("L")] for path in re.findall(' d="M(.*?)"', newest[1])
    )
    assert own == whole[-len(own) :] and len(own) == 16 and own[-1][1] < whole[0][1]
    assert "6.12&lt;b&gt;" in page and "<b>rt" not in page


def test_boards_that_are_too_new_are_not_called_good(tmp_path, capsys):
    """Only boards with a history can be called no worse."""
    with mock.patch("os.fsync"):
        for number in range(2):
            write_course(tmp_path / "archive", [100.0] * LEAST_BOOTS, machine=f"young-{number}", seed=number)

    def pages():
        assert main(["site", str(tmp_path / "archive"), "--output", str(tmp_path / "pages")]) == 0
        return ((tmp_path / "pages" / name).read_text() for name in ("index.html", "boards.html"))

    front, boards = pages()
    assert f"Of 2 scenarios 2 cannot be judged yet: {HISTORY}." in front and "Nothing got worse" not in boards
    assert '<p class="answer">2 of 2 boards too new to judge</p>' in boards
    assert f"? NEW: {LEAST_BOOTS} boots of {LEAST_BOOTS + 1}" in boards
    write_course(tmp_path / "archive", [100.0] * (LEAST_BOOTS + 1), machine="young-0", seed=0)
    front, boards = pages()
    assert '<p class="answer">Nothing got worse; 1 of 2 boards too new to judge</p>' in boards


def test_every_page_states_one_number_of_boots():
    """A history of so many boots, and the next one that is held against it: two levels that a change needs."""
    assert LEAST_BOOTS + 1 >= 2 * LEAST_UNITS
    words = {5: "five", 6: "six", 7: "seven"}
    pages = Path(__file__).parents[3] / "docs"
    archive, lab = ((pages / f"{name}.md").read_text() for name in ("archive", "lab"))
    assert f"A history takes {words[LEAST_BOOTS]} boots" in archive
    assert f"fewer than {words[LEAST_BOOTS + 1]} boots" in lab


PROBE = """<!DOCTYPE html><link rel="icon" href="data:,"><body><script>
addEventListener("load", async () => {
  const found = {};
  for (const width of [390, 800, 1400]) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `width:${width}px;height:900px;border:0`;
    frame.src = "boards.html";
    document.body.append(frame);
    await new Promise((done) => { frame.onload = done; });
    const page = frame.contentDocument, cells = [...page.querySelectorAll(".boards td:not(.empty)")];
    const boxes = cells.map((e) => e.getBoundingClientRect());
    found[width] = {
      scroll: page.documentElement.scrollWidth,
      cells: boxes.filter((box) => box.width > 100 && box.right <= width).length,
      cut: [...page.querySelectorAll("td *")].filter((e) => e.clientWidth && e.scrollWidth > e.clientWidth + 1).length,
      over: boxes.filter((a, k) => boxes.some((b, j) => j > k && a.left < b.right - 1 && b.left < a.right - 1 &&
        a.top < b.bottom - 1 && b.top < a.bottom - 1)).length,
      lines: [...page.querySelectorAll("svg")].filter((e) => e.getBoundingClientRect().height > 15).length,
      named: getComputedStyle(cells[0], "::before").content };
  }
  const text = document.createElement("pre");
  text.id = "found";
  text.textContent = JSON.stringify(found);
  document.body.replaceChildren(text);
});
</script>"""


def probed(folder, profile):
    """What the page `probe.html` of this folder found."""
    dom, console = browse(
        profile, "--allow-file-access-from-files", "--window-size=1500,1000", "--virtual-time-budget=60000",
        "--dump-dom", f"file://{folder}/probe.html",
    )  # fmt: skip
    assert console == []
    return json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', dom)[1]))


def test_the_page_of_boards_holds_at_every_width(boards, tmp_path):
    (boards / "probe.html").write_text(PROBE)
    for width, page in probed(boards, tmp_path).items():
        assert page["scroll"] <= int(width) and (page["cut"], page["over"]) == (0, 0), (width, page)
        assert (page["cells"], page["lines"]) == (12, 12), (width, page)
        assert page["named"] == ("none" if width == "1400" else '"rclcpp"')


PHONE = """<!DOCTYPE html><link rel="icon" href="data:,"><body><script>
addEventListener("load", async () => {
  const found = {};
  for (const name of NAMES) {
    const frame = document.createElement("iframe");
    frame.style.cssText = "width:390px;height:900px;border:0";
    frame.src = name;
    document.body.append(frame);
    await new Promise((done) => { frame.onload = done; });
    const page = frame.contentDocument;
    found[name] = [...page.querySelectorAll("html, body *")].filter((e) => e.clientWidth &&
      e.scrollWidth > e.clientWidth + 1 && !e.closest("svg") &&
      (e === page.documentElement || getComputedStyle(e).overflowX !== "visible"))
      .map((e) => `${e.tagName}.${e.className} ${e.scrollWidth}`);
    frame.remove();
  }
  const text = document.createElement("pre");
  text.id = "found";
  text.textContent = JSON.stringify(found);
  document.body.replaceChildren(text);
});
</script>"""


@pytest.mark.parametrize("pages", ["site", "boards"])
def test_no_page_scrolls_sideways_on_a_phone(pages, tmp_path, request):
    folder = request.getfixturevalue(pages)
    names = sorted(path.name for path in folder.glob("*.html") if path.name != "probe.html")
    (folder / "probe.html").write_text(PHONE.replace("NAMES", json.dumps(names)))
    found = probed(folder, tmp_path)
    assert [*found] == names and len(names) >= 3 and not any(found.values()), found


def test_the_page_of_a_scenario_has_its_course(site):
    (path,) = [path for path in site.glob("*.html") if re.fullmatch(r"[0-9a-f]{16}\.html", path.name)]
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


def test_without_a_deadline_nothing_counts_misses(tmp_path, capsys):
    """Two values of each run are later than the 400 us of the thesis, which are no default."""
    archive = write_course(tmp_path / "archive", [100.0] * 6, late=[2] * 6)
    assert main(["site", str(archive), "--output", str(tmp_path / "pages")]) == 0
    assert NO_DEADLINE in capsys.readouterr().err
    for page in (tmp_path / "pages").iterdir():
        text = page.read_text()
        if page.suffix == ".html" and page.name != "boards.html":
            assert "deadline 4" not in text and ">misses<" not in text and "Misses are not counted" in text
        assert page.name != "metrics.txt" or ("rtrun_value_seconds" in text and "miss" not in text)
    assert main(["history", str(archive)]) == 0
    printed = capsys.readouterr()
    assert "P(" not in printed.out and NO_DEADLINE in printed.err


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


@pytest.mark.parametrize("value_ns", [-5, -1, 0, 1, -(10**12), 10**12])
@pytest.mark.parametrize("days", [1, 3])
def test_values_that_are_all_the_same(tmp_path, capsys, value_ns, days):
    """A timer that fires 5 ns early each time is one that a clock of large steps shows."""
    archive = write_course(tmp_path / "archive", [100.0] * days, constant_ns=value_ns)
    assert main(["site", str(archive), "--output", str(tmp_path / "pages")]) == 0, capsys.readouterr().err
    (page,) = [path for path in (tmp_path / "pages").glob("*.html") if re.fullmatch(r"[0-9a-f]{16}\.html", path.name)]
    assert "NaN" not in page.read_text() and '"values"' in page.read_text()


@given(strategies.lists(strategies.integers(-(2**62), 2**62), min_size=1, max_size=5))
def test_a_plot_holds_all_of_its_values(values):
    """Whatever they are, the axis ascends, and its low end is at none of them but the lowest."""
    scale = _scale(values)
    axis = times("x", scale)
    assert math.isfinite(scale.low) and math.isfinite(scale.high) and scale.low < scale.high
    assert scale.low <= min(values) and max(values) <= scale.high
    places = [float(scale.at(value)) for value, _ in axis.ticks]
    assert len(places) >= 2 and places == sorted({*places})


def test_an_archive_without_times_has_no_site(capsys, tmp_path):
    (tmp_path / "empty").mkdir()
    assert main(["site", str(tmp_path / "empty"), "--output", str(tmp_path / "pages")]) == 2
    assert not (tmp_path / "pages").exists()
