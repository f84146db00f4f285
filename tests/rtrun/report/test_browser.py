"""The page in a real browser: no console error, nothing overflows on a phone, links lead somewhere."""

import functools
import http.server
import json
import re
import shutil
import subprocess
import threading

import pytest
from report.campaigns import latencies, oneshot_rows, write_run

from rtrun.cli import main

# Loads the page in frames of several widths and writes what it finds into its own title.
PROBE = """<!DOCTYPE html><link rel="icon" href="data:,"><title>waiting</title><body><script>
const widths = [360, 768, 1280], found = {};
addEventListener("load", async () => {
  for (const width of widths) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `width:${width}px;height:900px;border:0`;
    frame.src = "report.html";
    document.body.append(frame);
    await new Promise((done) => { frame.onload = done; });
    const page = frame.contentDocument, root = page.documentElement;
    const wide = [...page.querySelectorAll("body *")].filter((e) =>
      !e.closest(".wide table, svg, canvas, script") && e.getBoundingClientRect().right > width + 0.5);
    const dead = [...page.querySelectorAll("a[href]")].filter((a) => !page.querySelector(a.getAttribute("href")));
    const small = [...page.querySelectorAll("svg")].filter((e) => e.getBoundingClientRect().width > 0 &&
      e.getBoundingClientRect().width < 200);
    const canvas = page.querySelector("canvas");
    let drawn = 0, moved = false;
    if (canvas) {
      const look = () => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      const before = look();
      drawn = before.filter((v, i) => i % 4 === 3 && v > 0).length;
      const at = (type, x) => canvas.dispatchEvent(new frame.contentWindow.PointerEvent(type,
        { clientX: x, clientY: 10, pointerId: 1, bubbles: true }));
      canvas.setPointerCapture = () => {};
      at("pointerdown", 10); at("pointermove", 60); at("pointerup", 60);
      const after = look();
      moved = before.some((v, i) => v !== after[i]);
    }
    found[width] = { scroll: root.scrollWidth, wide: wide.map((e) => e.tagName + "." + e.className).slice(0, 5),
      dead: dead.map((a) => a.getAttribute("href")), small: small.length,
      links: page.querySelectorAll("a[href]").length,
      figures: page.querySelectorAll("figure svg").length, drawn, moved };
  }
  const text = document.createElement("pre");
  text.id = "found";
  text.textContent = JSON.stringify(found);
  document.body.replaceChildren(text);
});
</script>"""


@pytest.fixture(scope="module")
def folder(campaign, tmp_path_factory):
    target = tmp_path_factory.mktemp("page")
    assert main(["report", str(campaign), "--output", str(target / "report.html")]) == 0
    (target / "probe.html").write_text(PROBE)
    return target


@pytest.fixture(scope="module")
def site(folder):
    class Quiet(http.server.SimpleHTTPRequestHandler):
        requested: list[str] = []  # noqa: RUF012

        def log_message(self, *args):
            self.requested.append(self.path)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", Quiet.requested
    server.shutdown()


def browse(tmp_path, *arguments):
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
        f"--user-data-dir={tmp_path / 'profile'}",
        "--enable-logging=stderr",
        *arguments,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def test_the_page_holds_on_a_phone_and_on_a_desk(site, tmp_path):
    address, requested = site
    dom, console = browse(
        tmp_path, "--window-size=1400,1000", "--virtual-time-budget=60000", "--dump-dom", f"{address}/probe.html"
    )
    assert [line for line in console if "probe.html" not in line] == []
    found = json.loads(re.search(r'<pre id="found">(.*?)</pre>', dom, re.DOTALL).group(1).replace("&amp;", "&"))
    assert set(found) == {"360", "768", "1280"}
    for width, page in found.items():
        assert page["scroll"] <= int(width), page
        assert page["wide"] == [] and page["dead"] == [] and page["small"] == 0
        assert page["links"] >= 5 and page["figures"] > 20
        assert page["drawn"] > 1000 and page["moved"]
    assert set(requested) == {"/probe.html", "/report.html"}


def test_the_page_prints(folder, tmp_path):
    _, console = browse(
        tmp_path, f"--print-to-pdf={tmp_path / 'report.pdf'}", "--no-pdf-header-footer", f"file://{folder}/report.html"
    )
    assert console == [] and (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


def test_a_page_with_an_error_would_be_noticed(tmp_path):
    (tmp_path / "bad.html").write_text("<script>missing();</script>")
    _, console = browse(tmp_path, "--dump-dom", f"file://{tmp_path}/bad.html")
    assert len(console) == 1 and "missing" in console[0]


def test_a_page_of_almost_nothing(tmp_path):
    parameters = {"policy": "RR", "timeout_us": 1000, "busy_mode": 0}
    rows = [oneshot_rows(latencies(1, 1), 1000)]
    write_run(tmp_path / "r", "a", "oneshot_timer_tests", rows, parameters, asked=1, logs=False)
    assert main(["report", str(tmp_path / "r")]) == 0
    dom, console = browse(tmp_path, "--dump-dom", f"file://{tmp_path}/r/report.html")
    assert console == [] and "NEEDS MORE" in dom
