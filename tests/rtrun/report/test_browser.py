"""Pages in a real browser: no console error, nothing overflows on a phone, links lead somewhere."""

import csv
import functools
import html
import http.server
import io
import json
import re
import shutil
import subprocess
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from made_topology import made_topology, topology_of, write_topology_run
from plan.test_topology import BRAKING
from report.campaigns import latencies, oneshot_run
from written import NOT_FIRED

from rtrun.cli import main

_HARMLESS = "Blocked script execution"  # in the frame that may not run scripts
EVIL = "<img src=x onerror=missing()></script><script>missing()</script> %{x} <b>b</b>"
# Loads the pages in frames, uses them, and leaves what it sees as text.
PROBE = """<!DOCTYPE html><link rel="icon" href="data:,"><title>waiting</title><body><script>
const pages = {}, pause = (ms) => new Promise((done) => setTimeout(done, ms));
async function opened(address, width, scripts = true) {
  const frame = document.createElement("iframe");
  frame.style.cssText = `width:${width}px;height:900px;border:0`;
  if (!scripts) frame.sandbox = "allow-same-origin";
  frame.src = address;
  document.body.append(frame);
  await new Promise((done) => { frame.onload = done; });
  return frame;
}
const within = (e) => e.getClientRects().length && !e.closest(".wide > *");
const named = (elements) => elements.map((e) => `${e.tagName}.${e.getAttribute("class")} ${e.textContent}`).slice(0, 5);
// Texts that stand over one another.
function overlapping(texts) {
  const boxes = texts.map((e) => e.getBoundingClientRect());
  return texts.filter((_, k) => k && boxes[k].left < boxes[k - 1].right && boxes[k - 1].left < boxes[k].right &&
    boxes[k].top < boxes[k - 1].bottom && boxes[k - 1].top < boxes[k].bottom);
}
// What has to be moved to be read, and text wider than its place. Graphs may be, and tables between a phone and a desk.
const wider = (page, width) => [...page.querySelectorAll("body *")].filter((e) =>
  e.clientWidth && e.scrollWidth > e.clientWidth + 1 &&
  (!e.children.length || getComputedStyle(e).overflowX !== "visible") &&
  !e.closest("svg") && !e.matches(width === 800 ? ".wide" : ".wide:has(svg)"));
async function used(width) {
  const frame = await opened("report.html", width), page = frame.contentDocument, view = frame.contentWindow;
  const cards = [...page.querySelectorAll("details[data-suite]")];
  const rows = () => [...page.querySelectorAll("#overview a")].filter((row) => row.getClientRects().length);
  const open = cards.filter((card) => card.open).length, all = rows().length;
  const last = page.getElementById(rows().at(-1).hash.slice(1));
  last.open = false;
  rows().at(-1).click();
  await pause(300);
  const linked = last.open && page.title;
  for (const card of cards) card.open = card === cards[0] || card === cards.at(-1);
  const shown = (selector) => [...page.querySelectorAll(selector)].filter(within);
  const wide = shown("body *").filter((e) => e.getBoundingClientRect().right > width + 0.5);
  const overlap = overlapping(shown(".frame .x, .frame .y, .scale .x, .ticks .x"));
  // Of a graph: nodes whose text is wider than they are, texts of arrows that stand over each other or over a node.
  const boxes = [...page.querySelectorAll(".graph rect, .graph .label text")].map((e) => e.getBoundingClientRect());
  const graph = [...page.querySelectorAll(".graph .node")].filter((node) => {
    const [rect, text] = ["rect", "text"].map((name) => node.querySelector(name).getBoundingClientRect());
    return !(rect.width && rect.left <= text.left && text.right <= rect.right && text.bottom <= rect.bottom);
  }).map((node) => node.textContent).concat(boxes.flatMap((one, k) => boxes.slice(k + 1).filter((two) =>
    one.left < two.right && two.left < one.right && one.top < two.bottom - 1 && two.top < one.bottom - 1)));
  const limits = [...page.querySelectorAll(".frame b, .under b")].map((e) => e.textContent);
  const lines = ["limit", "grid"].map((kind) => view.getComputedStyle(page.querySelector(`path.${kind}`)))
    .map(({ stroke, strokeDasharray }) => [stroke, strokeDasharray]);
  const hovers = [...cards[0].querySelectorAll(".frame")].map((frame) => {
    const box = frame.getBoundingClientRect();
    const clientX = box.left + box.width / 3, clientY = box.bottom - box.height / 3;
    frame.dispatchEvent(new view.PointerEvent("pointermove", { clientX, clientY, bubbles: true }));
    return frame.querySelector(".tip").textContent;
  });
  const saved = [];
  view.URL.createObjectURL = (blob) => { saved.push(blob); return "#"; };
  for (const button of cards[0].querySelectorAll("button.csv")) button.click();
  const csv = await Promise.all(saved.map((blob) => blob.text()));
  const dead = [...page.querySelectorAll("a")].filter((a) => !page.getElementById(a.hash.slice(1))).map((a) => a.hash);
  view.dispatchEvent(new view.Event("beforeprint"));
  const printed = page.querySelectorAll("details:not([open])").length;
  const cut = wider(page, width);
  view.dispatchEvent(new view.Event("afterprint"));
  page.querySelector("select[name=policy]").value = "FIFO";
  page.querySelector("#filter").dispatchEvent(new view.Event("change"));
  const left = cards.filter((card) => !card.hidden).length;
  const filtered = [left, rows().length, page.querySelector("#shown").textContent];
  const scroll = page.documentElement.scrollWidth;
  frame.remove();
  return { scroll, wide: named(wide), overlap: named(overlap), cut: named(cut), dead, graph, boxes: boxes.length,
    open, all, linked, hovers, csv, printed, filtered, limits, lines };
}
// What a reader sees with every card open.
async function seen(address, scripts, width = 800) {
  const frame = await opened(address, width, scripts), page = frame.contentDocument;
  for (const card of page.querySelectorAll("details")) card.open = true;
  await pause(200);
  const worst = page.querySelector("[id$=--figures] + .wide td.n")?.getBoundingClientRect().right;
  return { scroll: page.documentElement.scrollWidth, worst, cut: named(wider(page, width)), text: page.body.innerText,
    images: page.querySelectorAll("img:not(.frame > img)").length,
    scripted: page.documentElement.classList.contains("scripted"),
    plots: [...page.querySelectorAll(".frame svg")].filter((plot) => plot.getBoundingClientRect().height > 50).length,
    tables: [...page.querySelectorAll("table")].filter((table) => table.getClientRects().length).length };
}
addEventListener("load", async () => {
  for (const width of [390, 800, 1280]) pages[width] = await used(width);
  pages.still = await seen("report.html", false);
  for (const name of ["hostile", "bad"]) pages[name] = await seen(`${name}.html`, true);
  for (const width of [390, 1280]) pages[`tiny ${width}`] = await seen("tiny.html", true, width);
  const text = document.createElement("pre");
  text.id = "pages";
  text.textContent = JSON.stringify(pages);
  document.body.replaceChildren(text);
});
</script>"""


@dataclass(frozen=True, kw_only=True)
class Visit:
    """What the probe found on each page, what the browser logged, and the paths it asked for."""

    pages: dict[str, Any]
    console: list[str]
    requested: set[str]


@pytest.fixture(scope="module")
def folder(campaign, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    results = shutil.copytree(campaign, folder / campaign.name)
    write_topology_run(results / "900-topology", made_topology(topology_of(folder, BRAKING)))
    assert main(["report", str(results), "--deadline", "400us", "--output", str(folder / "report.html")]) == 0
    target = {"name": EVIL, "kernel_release": EVIL, "kernel_version": EVIL}
    hostile = folder / "<b>results"
    for name in ("a<img src=y onerror=missing()>", "b" * 200):
        oneshot_run(hostile, name, latencies(500, 1), parameters={"cpu": EVIL}, target=target)
    assert main(["report", str(hostile), "--deadline", "90us", "--output", str(folder / "hostile.html")]) == 0
    values = np.concatenate([latencies(1, 1), [NOT_FIRED] * 100_000])
    oneshot_run(folder / "one", "001-oneshot_timer_tests_l20000_tm1000-tnRTFIFO-trace-1000us-r2", values)
    assert main(["report", str(folder / "one"), "--output", str(folder / "tiny.html")]) == 0
    (folder / "bad.html").write_text("<script>missing();</script>")
    (folder / "probe.html").write_text(PROBE)
    return folder


@pytest.fixture(scope="module")
def visit(folder, tmp_path_factory):
    """One browser that opens every page."""
    requested = set()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            requested.add(self.path)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        dom, console = browse(
            tmp_path_factory.mktemp("profile"),
            "--window-size=1400,1000",
            "--virtual-time-budget=400000",
            "--dump-dom",
            f"http://127.0.0.1:{server.server_port}/probe.html",
        )
    finally:
        server.shutdown()
        server.server_close()
    text = re.search(r'<pre id="pages">(.*?)</pre>', dom, re.DOTALL)
    assert text, (dom[:2000], console)
    return Visit(pages=json.loads(html.unescape(text.group(1))), console=console, requested=requested)


def browse(profile, *arguments):
    """Run Chromium once; returns its standard output and what it logged to the console."""
    program = shutil.which("chromium")
    assert program, "apt-get install chromium"
    command = [
        program,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--disable-dev-shm-usage",
        f"--user-data-dir={profile}",
        "--enable-logging=stderr",
        *arguments,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    return done.stdout, [
        line for line in done.stderr.splitlines() if "CONSOLE" in line and not re.search(_HARMLESS, line)
    ]


def test_no_page_has_an_error_but_the_one_that_was_made_with_one(visit):
    (error,) = visit.console
    assert "missing is not defined" in error and "bad.html" in error


def test_nothing_is_fetched(visit):
    pages = ("probe", "report", "hostile", "tiny", "bad")
    assert visit.requested == {f"/{name}.html" for name in pages}


@pytest.mark.parametrize("width", [390, 800, 1280])
def test_the_page_holds_on_a_phone_and_on_a_desk(visit, width):
    page = visit.pages[str(width)]
    assert page["scroll"] <= width, page
    assert [page[what] for what in ("wide", "overlap", "cut", "dead", "graph")] == [[]] * 5
    assert page["boxes"] == 11, "six nodes, five messages"
    assert page["all"] == 15 and page["open"] == 3, "the worst three of those that failed"
    assert page["linked"].startswith("cyclic_timer FIFO 1000 Hz – ")
    assert page["printed"] == 0 and page["filtered"] == [5, 5, "5 scenarios"]


def test_a_deadline_has_its_name_at_its_line_and_looks_like_no_other_line(visit):
    page = visit.pages["1280"]
    assert page["limits"].count("deadline 400 us") == 1 + 15 * 3, "of the overview, and of three plots of each scenario"
    (limit, limit_dashes), (grid, grid_dashes) = page["lines"]
    assert limit != grid and grid_dashes == "none" != limit_dashes


def test_a_plot_tells_its_data(visit):
    page = visit.pages["1280"]
    times = r"-?[0-9.]+ (ns|us|ms|s)"
    assert len(page["hovers"]) == 4 and all(re.search(times, text) for text in page["hovers"]), page["hovers"]
    rows = [list(csv.reader(io.StringIO(text))) for text in page["csv"]]
    assert [row[0][-1] for row in rows] == ["count", "share above", "lowest", "count"]
    assert all("latency of messages in ns" in ", ".join(row[0]) for row in rows)
    assert sum(float(count) for line, _, count in rows[0][1:] if line == "subscriber 1") == 3999


def test_without_scripts_the_answers_and_tables_are_there(visit):
    still = visit.pages["still"]
    assert not still["scripted"] and still["tables"] > 20
    assert "scenarios failed. The 3 worst of them are open, the other" in still["text"]
    assert "is not met in 7 of 15 scenarios, not known yet in 8." in still["text"] and still["plots"] == 60


def test_hostile_names_stay_text(visit):
    page = visit.pages["hostile"]
    assert page["images"] == 0 and page["scroll"] <= 800, "a name without a space takes several lines"
    assert EVIL in page["text"] and "a<img src=y onerror=missing()>" in page["text"]


def test_a_page_of_almost_nothing_on_a_phone(visit):
    """The highest value is seen beside whatever name a run has."""
    page = visit.pages["tiny 390"]
    assert "no deadline" in page["text"] and page["scroll"] <= 390 and page["worst"] < 390
    assert page["cut"] == visit.pages["tiny 1280"]["cut"] == []


def test_the_page_prints(folder, tmp_path):
    _, console = browse(
        tmp_path / "profile",
        f"--print-to-pdf={tmp_path / 'report.pdf'}",
        "--no-pdf-header-footer",
        f"file://{folder}/report.html",
    )
    pages = subprocess.run(
        ["pdftotext", "-layout", tmp_path / "report.pdf", "-"], capture_output=True, text=True, check=True
    ).stdout.split("\f")[:-1]
    assert console == [] and all(len(page.split()) > 20 for page in pages), "no page is empty"
    assert all(filled > 0.5 for filled in _filled(tmp_path / "report.pdf")[:-1]), "no page is half empty but the last"
    text = "".join(pages)
    assert text.count("Figures\n") == 15 and "How to reproduce" in text and "Clopper" in text


def test_a_small_report_is_a_few_sheets_of_paper(folder, tmp_path):
    browse(tmp_path / "profile", f"--print-to-pdf={tmp_path / 'tiny.pdf'}", f"file://{folder}/tiny.html")
    assert len(_filled(tmp_path / "tiny.pdf")) <= 3


def _filled(pdf):
    """The part of the height of each page down to its lowest word, without headers and footers."""
    boxes = subprocess.run(["pdftotext", "-bbox", pdf, "-"], capture_output=True, text=True, check=True).stdout
    pages = re.findall(r'<page width="[0-9.]+" height="([0-9.]+)">(.*?)</page>', boxes, re.DOTALL)
    return [
        max((float(low) for low in re.findall(r'yMax="([0-9.]+)"', words)), default=0.0) / float(height)
        for height, words in pages
    ]
