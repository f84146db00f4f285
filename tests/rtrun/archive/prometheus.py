"""`make test-archive`: a real Prometheus scrapes a site's metrics, from a web server and through node_exporter."""

import functools
import http.server
import json
import subprocess
import threading
import time
import urllib.parse
import urllib.request
from datetime import UTC, datetime
from pathlib import Path

import pytest
from archive.archived import write_course

from ports import free_port
from rtrun.cli import main

PROGRAMS = Path(__file__).parents[3] / "build" / "prometheus" / "usr" / "bin"


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass


@pytest.fixture
def site(capsys, tmp_path):
    """A site of runs of months ago, on a web server: its folder and its port."""
    archive = write_course(tmp_path / "archive", [100.0] * 8)
    assert main(["site", str(archive), "--output", str(tmp_path / "public")]) == 0
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", free_port()), functools.partial(Quiet, directory=tmp_path / "public")
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield tmp_path / "public", server.server_port
    server.shutdown()
    server.server_close()


@pytest.fixture
def prometheus(site, tmp_path):
    """A question to a Prometheus that scrapes both; waits for the answer."""
    folder, web = site
    texts = tmp_path / "textfiles"
    texts.mkdir()
    (texts / "rtrun.prom").write_bytes((folder / "metrics.txt").read_bytes())
    node, port = free_port(), free_port()
    config = tmp_path / "prometheus.yml"
    jobs = [
        {"job_name": name, "metrics_path": path, "static_configs": [{"targets": [f"127.0.0.1:{at}"]}]}
        for name, path, at in (("web", "/metrics.txt", web), ("node", "/metrics", node))
    ]
    config.write_text(json.dumps({"global": {"scrape_interval": "1s"}, "scrape_configs": jobs}))
    listens = "--web.listen-address=127.0.0.1:"
    exporter = [PROGRAMS / "prometheus-node-exporter", f"{listens}{node}", "--collector.disable-defaults",
                "--collector.textfile", f"--collector.textfile.directory={texts}"]  # fmt: skip
    server = [PROGRAMS / "prometheus", f"{listens}{port}", f"--config.file={config}",
              f"--storage.tsdb.path={tmp_path / 'data'}"]  # fmt: skip
    with (tmp_path / "log").open("w") as log:
        started = [subprocess.Popen(command, stdout=log, stderr=log) for command in (exporter, server)]

    def ask(query, *, series):
        url = f"http://127.0.0.1:{port}/api/v1/query?{urllib.parse.urlencode({'query': query})}"
        known = []
        for _ in range(240):
            try:
                with urllib.request.urlopen(url, timeout=5) as answer:
                    known = json.load(answer)["data"]["result"]
            except OSError:
                known = []
            if len(known) == series:
                return {sample["metric"].get("job"): float(sample["value"][1]) for sample in known}
            time.sleep(0.25)
        raise AssertionError(f"{known}\n{(tmp_path / 'log').read_text()[-2000:]}")

    yield ask
    for process in started:
        process.terminate()
        process.wait()


def test_what_was_measured_months_ago_is_there_in_both_ways(prometheus, site):
    values = prometheus('rtrun_value_seconds{percentile="50"}', series=2)
    assert values.keys() == {"web", "node"} and len({*values.values()}) == 1 and 9e-5 < values["web"] < 1.1e-4
    assert (
        prometheus("rtrun_run_start_time_seconds", series=2)["node"] == datetime(2026, 1, 8, 11, tzinfo=UTC).timestamp()
    )
    assert prometheus("time() - rtrun_run_start_time_seconds > 172800", series=2)
    assert prometheus("node_textfile_scrape_error", series=1) == {"node": 0}
    lint = [PROGRAMS / "promtool", "check", "metrics"]
    done = subprocess.run(lint, input=(site[0] / "metrics.txt").read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
