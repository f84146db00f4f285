"""A labgrid farm for tests: a real coordinator, a real exporter, and power switches with a REST interface."""

import contextlib
import http.server
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from signal import SIGTERM
from typing import Any

from ports import free_port
from rtrun.targets.labgrid import coordinator as labgrid


class Farm:
    """A coordinator and its places."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.coordinator = folder, f"127.0.0.1:{port}"
        self._servers: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, server: str) -> None:
        """Start `coordinator` or `exporter`, and wait until it is ready."""
        of_exporter = ("-c", self.coordinator, "-n", "bench", "exporter.yaml")
        words = ("-l", self.coordinator) if server == "coordinator" else of_exporter
        log = self.folder / f"{server}.log"
        with log.open("wb") as output:
            command = [sys.executable, "-m", f"labgrid.remote.{server}", *words]
            process = subprocess.Popen(command, cwd=self.folder, stdout=output, stderr=output)
        self._servers[server] = process
        while server == "coordinator" and "listening on" not in log.read_text():
            assert process.poll() is None, log.read_text()
            time.sleep(0.05)

    def end(self, server: str, signal: int = SIGTERM) -> None:
        """End a server that may have ended by itself."""
        self._servers[server].send_signal(signal)
        self._servers.pop(server).wait(60)

    def end_all(self) -> None:
        for server in reversed([*self._servers]):
            self.end(server)

    def await_resources(self, expected: Collection[str]) -> None:
        """Wait until the exporter offers these, as ``group/kind``."""
        while not {*expected} <= {
            f"{resource.group}/{resource.kind}" for resource in labgrid.list_resources(self.coordinator)
        }:
            assert self._servers["exporter"].poll() is None, (self.folder / "exporter.log").read_text()
            time.sleep(0.2)

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
    try:
        # What a coordinator wrote that was ended: each call of the client would take a second.
        places = {
            name: {
                "tags": dict(tags) if group else {},
                "matches": [{"exporter": "bench", "group": name, "cls": "*"}],
            }
            for name, group in resources.items()
        }
        (folder / "places.yaml").write_text(json.dumps(places))
        farm.start("coordinator")
        farm.start("exporter")
        farm.await_resources([f"{name}/{kind}" for name, group in resources.items() for kind in group])
        yield farm
    finally:
        farm.end_all()


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
