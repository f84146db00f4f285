"""A labgrid farm for tests: a real coordinator, a real exporter, and power switches with a REST interface."""

import contextlib
import http.server
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ports import free_port
from rtrun.targets.labgrid import places as labgrid


class Farm:
    """A coordinator and its places."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.coordinator = folder, f"127.0.0.1:{port}"

    def client(self, *words: str, user: str | None = None) -> str:
        """Call labgrid's client, as this user or another one; return what it prints."""
        environment = os.environ | ({"LG_USERNAME": user} if user else {})
        command = [sys.executable, "-m", "labgrid.remote.client", "-x", self.coordinator, *words]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    def place(self, name: str) -> labgrid.LabgridPlace:
        return next(place for place in labgrid.list_places(self.coordinator) if place.name == name)

    def await_free(self, name: str) -> None:
        while self.place(name).holder:
            time.sleep(0.2)


@contextlib.contextmanager
def farm_of(folder: Path, resources: Mapping[str, Mapping[str, Any]], tags: Mapping[str, str]) -> Iterator[Farm]:
    """Run coordinator and exporter; each place has the exported resources of its name, and `tags` where it has any."""
    farm = Farm(folder, free_port())
    (folder / "exporter.yaml").write_text(json.dumps({name: group for name, group in resources.items() if group}))
    with contextlib.ExitStack() as stack:
        coordinator = (sys.executable, "-m", "labgrid.remote.coordinator", "-l", farm.coordinator)
        stack.enter_context(_running(*coordinator, folder=folder, ready="listening on"))
        exporter = (sys.executable, "-m", "labgrid.remote.exporter", "-c", farm.coordinator, "-n", "bench")
        exporting = stack.enter_context(_running(*exporter, "exporter.yaml", folder=folder))
        for name, group in resources.items():
            farm.client("-p", name, "create")
            farm.client("-p", name, "add-match", f"bench/{name}/*")
            if group:
                farm.client("-p", name, "set-tags", *(f"{key}={value}" for key, value in tags.items()))
        expected = [f"bench/{name}/{kind}" for name, group in resources.items() for kind in group]
        while not all(path in farm.client("resources") for path in expected):
            assert exporting.poll() is None, (folder / "exporter.log").read_text()
            time.sleep(1)
        yield farm


@contextlib.contextmanager
def _running(*command: str, folder: Path, ready: str = "") -> "Iterator[subprocess.Popen[bytes]]":
    """Run a server until the context is left; it is ready when it prints what `ready` says."""
    log = folder / f"{command[2].rpartition('.')[2]}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=output)
    try:
        while ready not in log.read_text():
            assert process.poll() is None, log.read_text()
            time.sleep(0.05)
        yield process
    finally:
        process.terminate()
        process.wait(60)


@contextlib.contextmanager
def power_switch(switch: Callable[[bool], None]) -> Iterator[dict[str, str]]:
    """A power switch as labgrid's model `simplerest` drives it; yields its NetworkPowerPort."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            switch(self.path == "/1")
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        host = f"http://127.0.0.1:{server.server_port}/{{value}}"
        yield {"model": "simplerest", "host": host, "index": "0"}
        server.shutdown()
