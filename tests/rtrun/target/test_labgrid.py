"""Boards of a farm: a real labgrid coordinator and exporter on loopback, whose places are real SSH servers."""

import contextlib
import http.server
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from faulty import write_faulty_suites

from conftest import SSHD, serve
from ports import free_port
from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.commands._boards import read_targets
from rtrun.target import labgrid
from rtrun.target.config import parse_target

pytest.importorskip("labgrid", reason="pip install meta-rt-tests[farm]")


# Every call of labgrid's client takes a second, and a campaign makes five.
def on_farm(test):
    for mark in (pytest.mark.sshd, pytest.mark.ros, pytest.mark.slow):
        test = mark(test)
    return test


CAMPAIGN = "schema: 1\nname: test\nruns: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101]}]\n"


class Farm:
    """A coordinator, an exporter, and their places."""

    def __init__(self, folder, port):
        self.folder, self.coordinator = folder, f"127.0.0.1:{port}"
        self.cycles = []

    def client(self, *words, user=None):
        environment = os.environ | ({"LG_USERNAME": user} if user else {})
        command = [sys.executable, "-m", "labgrid.remote.client", "-x", self.coordinator, *words]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    def place(self, name="panda-1"):
        return next(place for place in labgrid.list_places(self.coordinator) if place.name == name)

    def await_free(self, name="panda-1"):
        while self.place(name).holder:
            time.sleep(0.2)


@contextlib.contextmanager
def running(*command, folder, ready=None):
    """Run a server until the context is left; it is ready when it prints what `ready` says."""
    log = folder / f"{command[2].rpartition('.')[2]}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=output)
    try:
        while ready and ready not in log.read_text():
            assert process.poll() is None, log.read_text()
            time.sleep(0.05)
        yield process
    finally:
        process.terminate()
        process.wait(60)


@contextlib.contextmanager
def power_switch(switch):
    """A power switch with a REST interface, as labgrid's model `simplerest` drives it."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            switch(self.path == "/1")
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@contextlib.contextmanager
def serial_port(text):
    """A serial port behind TCP that prints a text to whoever connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with contextlib.suppress(OSError):
                while True:
                    stream, _ = server.accept()
                    stream.sendall(text)

        threading.Thread(target=answer, daemon=True).start()
        yield server.getsockname()[1]


@pytest.fixture(scope="module")
def servers(tmp_path_factory):
    """Coordinator and exporter with the place panda-1: an sshd that its power switch ends and starts again."""
    folder = tmp_path_factory.mktemp("farm")
    farm = Farm(folder, free_port())
    (folder / "sshd").mkdir()
    with contextlib.ExitStack() as stack:
        sshd = stack.enter_context(serve(folder / "sshd"))
        farm.sshd, farm.process = sshd, sshd.process

        def switch(is_on):
            farm.cycles.append(is_on)
            if is_on:
                farm.process = subprocess.Popen(
                    [SSHD, "-D", "-e", "-f", sshd.folder / "config"], stderr=subprocess.DEVNULL
                )
                stack.callback(farm.process.kill)
            else:
                farm.process.kill()

        farm.switch = switch
        power = stack.enter_context(power_switch(switch))
        serial = stack.enter_context(serial_port(b"U-Boot 2026.10\r\nlogin:"))
        service = {"address": "127.0.0.1", "port": sshd.port, "username": sshd.user}
        group = {
            "NetworkService": service,
            "NetworkPowerPort": {"model": "simplerest", "host": f"http://127.0.0.1:{power}/{{value}}", "index": "0"},
            "NetworkSerialPort": {"host": "127.0.0.1", "port": serial, "protocol": "raw"},
        }
        (folder / "exporter.yaml").write_text(json.dumps({"panda": group}))
        coordinator = (sys.executable, "-m", "labgrid.remote.coordinator", "-l", farm.coordinator)
        stack.enter_context(running(*coordinator, folder=folder, ready="listening on"))
        exporter = (sys.executable, "-m", "labgrid.remote.exporter", "-c", farm.coordinator, "-n", "bench")
        exporting = stack.enter_context(running(*exporter, "exporter.yaml", folder=folder))
        for name, group in (("panda-1", "panda"), ("empty-1", "none")):
            farm.client("-p", name, "create")
            farm.client("-p", name, "add-match", f"bench/{group}/*")
        farm.client("-p", "panda-1", "set-tags", "board=panda")
        while "NetworkSerialPort" not in farm.client("resources"):
            assert exporting.poll() is None, (folder / "exporter.log").read_text()
            time.sleep(1)
        yield farm


@pytest.fixture
def farm(servers, tmp_path, monkeypatch, ros_master):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LG_COORDINATOR", raising=False)
    servers.wishes = write_faulty_suites(tmp_path / "suites")
    servers.cycles.clear()
    Path("campaign.yml").write_text(CAMPAIGN)
    servers.keys = {
        "key": str(servers.sshd.key),
        "host_key": servers.sshd.host_key,
        "suites": "suites",
        "work_dir": str(tmp_path / "target"),
        "ros_master_port": ros_master,
        "reconnect_s": 0,
        "boot_s": 30,
        "coordinator": servers.coordinator,
    }
    yield servers
    assert not servers.place().holder and not servers.place().reservation, "it was given back"


def write_target(farm, **keys):
    data = {"schema": 1, "name": "panda", "kind": "labgrid", **farm.keys, **keys}
    Path("target.yml").write_text(json.dumps(data))
    return ["run", "campaign.yml", "--target", "target.yml"]


def records():
    return [json.loads(path.read_text()) for path in sorted(Path("results/test").glob("0*/run.json"))]


@on_farm
def test_a_place_is_acquired_measured_on_and_given_back(farm):
    assert main(write_target(farm, filter={"board": "panda"})) == 0
    assert [record["status"] for record in records()] == ["ok", "ok"]
    assert {record["target"]["name"] for record in records()} == {"panda-1"}, "the place that was taken"
    assert "U-Boot" in Path("results/test/console.log").read_text()
    assert "console.log" in records()[0]["files"]


@on_farm
def test_a_dead_board_is_switched_off_and_on_and_the_campaign_goes_on(farm, capsys):
    farm.switch(False)
    farm.cycles.clear()
    assert main(write_target(farm, place="panda-1")) == 0
    assert farm.cycles == [False, True] and len(records()) == 2
    assert "switching its power off and on" in capsys.readouterr().err


@on_farm
def test_a_board_that_never_boots(farm, capsys):
    farm.switch(False)
    config = farm.sshd.folder / "config"
    config.rename(config.with_suffix(".away"))
    try:
        assert main(write_target(farm, place="panda-1", boot_s=1)) == 3
    finally:
        config.with_suffix(".away").rename(config)
        farm.switch(True)
    err = capsys.readouterr().err
    assert "tried for 1 s since its power was switched off and on" in err and "login:" in err


@on_farm
def test_a_place_that_somebody_holds_is_reserved_and_waited_for(farm, capsys):
    farm.client("-p", "panda-1", "acquire", user="alice")

    def give_back():
        while not farm.client("reservations"):
            time.sleep(0.1)
        farm.client("-p", "panda-1", "release", user="alice")

    helper = threading.Thread(target=give_back)
    helper.start()
    assert main(write_target(farm, place="panda-1")) == 0
    helper.join()
    assert f"panda-1 is held by {socket.gethostname()}/alice: reserved, and waited for" in capsys.readouterr().err
    assert not farm.client("reservations")


@on_farm
def test_a_place_that_this_user_acquired_stays_acquired(farm, capsys):
    farm.client("-p", "panda-1", "acquire")
    try:
        assert main(write_target(farm, place="panda-1")) == 0
        assert farm.place().holder
    finally:
        farm.client("-p", "panda-1", "release")
    assert "acquired by" in capsys.readouterr().err


@on_farm
def test_a_killed_runner_gives_the_place_back_and_the_next_call_goes_on(farm):
    words = write_target(farm, place="panda-1")
    farm.wishes.will("sleep 2")
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.DEVNULL)
    farm.wishes.await_calls()
    assert farm.place().holder
    process.send_signal(signal.SIGKILL)
    process.wait()
    farm.await_free()
    assert main(words) == 0
    assert len(records()) == len(farm.wishes.calls()) == 2, "the run that went on was picked up"


@on_farm
def test_labgrids_environment_file_names_key_and_coordinator(farm):
    targets = {
        "main": {
            "resources": {"RemotePlace": {"name": "panda-1"}},
            "drivers": [{"SSHDriver": {"keyfile": farm.keys.pop("key")}}],
        }
    }
    Path("env.yaml").write_text(json.dumps({"targets": targets, "options": {"coordinator_address": farm.coordinator}}))
    del farm.keys["coordinator"]
    assert main(write_target(farm, place="panda-1", environment="env.yaml")) == 0


@on_farm
def test_every_place_with_a_tag_and_every_place_of_an_environment_file(farm, monkeypatch):
    monkeypatch.setenv("LG_COORDINATOR", farm.coordinator)
    (target,) = read_targets([], ["labgrid:board=panda"])
    assert (target.name, target.config.place) == ("panda-1", "panda-1")
    with pytest.raises(UsageError, match="has no such place; its places: "):
        read_targets([], ["labgrid:board=fish"])
    Path("env.yaml").write_text("targets: {main: {resources: {RemotePlace: {name: bare-1}}}}\n")
    (target,) = read_targets([], (), Path("env.yaml"))
    assert (target.config.place, target.config.environment) == ("bare-1", str(Path("env.yaml").absolute()))


@pytest.mark.parametrize("wrong", ["panda", "labgrid:", "labgrid:panda", "labgrid:=a", "ssh:a=b"])
def test_targets_are_given_by_tags(wrong):
    with pytest.raises(UsageError, match="takes labgrid:KEY=VALUE"):
        read_targets([], [wrong])


@on_farm
def test_no_target_at_all(farm, capsys):
    assert main(["run", "campaign.yml"]) == 2
    assert "name what to measure on: --target FILE" in capsys.readouterr().err


@on_farm
@pytest.mark.parametrize(
    ("keys", "status", "message"),
    [
        ({"place": "panda-9"}, 2, "has no place with name=panda-9; its places: panda-1, empty-1"),
        ({"filter": {"board": "fish"}}, 2, "has no place with board=fish"),
        ({"place": "empty-1"}, 3, "empty-1"),
        (
            {"place": "panda-1", "coordinator": "127.0.0.1:1"},
            3,
            "the labgrid coordinator at 127.0.0.1:1 does not answer",
        ),
    ],
)
def test_what_cannot_be_had_is_one_line(farm, capsys, keys, status, message):
    assert main(write_target(farm, **keys)) == status
    err = capsys.readouterr().err
    assert message in err and "Traceback" not in err


def test_a_target_file_names_a_place_or_tags():
    keys = {"schema": 1, "name": "panda", "kind": "labgrid"}
    for wrong in ({}, {"place": "a", "filter": {"board": "panda"}}):
        with pytest.raises(UsageError, match="give either place: NAME, or filter: with tags of the place"):
            parse_target(keys | wrong, "target.yml")


def test_an_environment_file_without_a_place(tmp_path):
    (tmp_path / "env.yaml").write_text("targets: {main: {drivers: {}}}\n")
    with pytest.raises(UsageError, match="names no RemotePlace"):
        labgrid.read_environment(tmp_path / "env.yaml")


def test_labgrid_is_loaded_for_its_own_targets_only():
    code = (
        "import sys, rtrun.commands._boards\n"
        "sys.exit(any(name.split('.')[0] in ('labgrid', 'grpc', 'serial') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
