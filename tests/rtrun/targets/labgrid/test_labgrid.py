"""Boards of a farm: a real labgrid coordinator and exporter on loopback, whose places are real SSH servers."""

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from datetime import date
from pathlib import Path

import pytest
from faulty import write_faulty_suites
from labgrid_farm import farm_of, power_switch

from conftest import SSHD, serve
from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.commands._boards import read_targets
from rtrun.results.journal import place_of_begun
from rtrun.targets.config import parse_target
from rtrun.targets.labgrid import environment as labgrid_environment
from rtrun.targets.labgrid import watch
from rtrun.targets.labgrid.coordinator import list_resources
from rtrun.targets.labgrid.health import after_failure, after_success, in_words

pytest.importorskip("labgrid", reason="the extra farm is not installed")


# Every call of labgrid's client takes a second, and a campaign makes five.
def on_farm(test):
    for mark in (pytest.mark.sshd, pytest.mark.ros, pytest.mark.slow):
        test = mark(test)
    return test


OFFERED = ["panda-1/NetworkService", "panda-1/NetworkPowerPort", "spare-1/NetworkService"]
CAMPAIGN = "schema: 1\nname: test\nruns: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101]}]\n"


@contextlib.contextmanager
def serial_port(text):
    """A serial port behind TCP that prints a text again and again: what comes at once the reader drops."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def talk(stream):
            with contextlib.suppress(OSError), stream:
                while True:
                    stream.sendall(text)
                    time.sleep(0.2)

        def answer():
            with contextlib.suppress(OSError):
                while True:
                    stream, _ = server.accept()
                    threading.Thread(target=talk, args=(stream,), daemon=True).start()

        threading.Thread(target=answer, daemon=True).start()
        yield server.getsockname()[1]


@pytest.fixture(scope="module")
def servers(tmp_path_factory):
    """Coordinator and exporter with the place panda-1: an sshd that its power switch ends and starts again."""
    folder = tmp_path_factory.mktemp("farm")
    (folder / "sshd").mkdir()
    cycles = []
    with contextlib.ExitStack() as stack:
        sshd = stack.enter_context(serve(folder / "sshd"))
        running = [sshd.process]

        def switch(is_on):
            cycles.append(is_on)
            if is_on:
                again = [SSHD, "-D", "-e", "-f", sshd.folder / "config"]
                running.append(subprocess.Popen(again, stderr=subprocess.DEVNULL))
                stack.callback(running[-1].kill)
            else:
                running[-1].kill()

        serial = stack.enter_context(serial_port(b"U-Boot 2026.10\r\nlogin:"))
        group = {
            "NetworkService": {"address": "127.0.0.1", "port": sshd.port, "username": sshd.user},
            "NetworkPowerPort": stack.enter_context(power_switch(switch)),
            "NetworkSerialPort": {"host": "127.0.0.1", "port": serial, "protocol": "raw"},
        }
        (folder / "spare").mkdir()
        spare = stack.enter_context(serve(folder / "spare"))
        service = {"address": "127.0.0.1", "port": spare.port, "username": spare.user}
        resources = {"panda-1": group, "spare-1": {"NetworkService": service}, "empty-1": {}}
        farm = stack.enter_context(farm_of(folder, resources, {"board": "panda"}))
        farm.client("-p", "spare-1", "set-tags", "board=", "healthy=yes")
        farm.sshd, farm.switch, farm.cycles, farm.spare = sshd, switch, cycles, spare
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
    assert not servers.place("panda-1").holder and not servers.place("panda-1").reservation, "it was given back"


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
    assert int(farm.place("panda-1").tags["power_cycles"]) >= 1
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
        assert farm.place("panda-1").holder
    finally:
        farm.client("-p", "panda-1", "release")
    assert "acquired by" in capsys.readouterr().err


@on_farm
def test_of_two_runners_of_one_user_that_begin_at_once_one_waits_and_says_so(farm, tmp_path):
    """Both see the place free."""
    words = write_target(farm, filter={"board": "panda"})
    gate = tmp_path / "gate"
    farm.wishes.will(f"await {gate}")
    logs = [tmp_path / name for name in ("one", "two")]
    runners = []
    for path in logs:
        with path.open("w") as stderr:
            command = [sys.executable, "-m", "rtrun.cli", *words, "--results", f"results/{path.name}"]
            runners.append(subprocess.Popen(command, stderr=stderr))
    while not any("reserved, and waited for" in path.read_text() for path in logs):
        assert all(runner.poll() is None for runner in runners)
        time.sleep(0.1)
    gate.touch()
    assert [runner.wait() for runner in runners] == [0, 0]
    (line,) = [line for path in logs for line in path.read_text().splitlines() if "waited for" in line]
    assert "panda-1 is held by" in line or "panda-1 is reserved" in line
    assert len(farm.wishes.calls()) == 4


@on_farm
def test_a_killed_runner_gives_the_place_back_and_the_next_call_goes_on(farm):
    words = write_target(farm, place="panda-1")
    farm.wishes.will("sleep 2")
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.DEVNULL)
    farm.wishes.await_calls()
    assert farm.place("panda-1").holder
    process.send_signal(signal.SIGKILL)
    process.wait()
    # Of several places that one is taken again.
    assert place_of_begun(Path("results/test"), "panda") == "panda-1"
    farm.await_free("panda-1")
    assert main(words) == 0
    assert place_of_begun(Path("results/test"), "panda") is None
    assert len(records()) == len(farm.wishes.calls()) == 2, "the run that went on was picked up"


@on_farm
def test_what_becomes_of_coordinator_and_exporter_meanwhile_is_said_and_measuring_goes_on(farm, capsys, monkeypatch):
    """The exporter ends and is there again; the coordinator is killed, and does not know any more who had the place."""
    monkeypatch.setattr(watch, "WATCH_S", 0.2)
    words = write_target(farm, place="panda-1")
    farm.wishes.will(f"await {Path('gate').absolute()}")

    def injure():
        farm.wishes.await_calls()
        farm.end("exporter", signal.SIGKILL)
        while any(resource.group == "panda-1" for resource in list_resources(farm.coordinator)):
            time.sleep(0.1)
        time.sleep(1)
        farm.start("exporter")
        farm.await_resources(OFFERED)
        farm.end("coordinator", signal.SIGKILL)
        farm.end("exporter")
        farm.start("coordinator")
        farm.start("exporter")
        while not (farm.place("panda-1").holder or "").partition("/")[2].rpartition("-rtrun-")[0]:
            time.sleep(0.1)
        Path("gate").touch()

    helper = threading.Thread(target=injure)
    helper.start()
    assert main(words) == 0
    helper.join()
    err = capsys.readouterr().err
    reported = "nobody offers bench/panda-1/*: the exporter bench ended or was not started (labgrid-exporter)"
    assert f"place panda-1: {reported}; measuring goes on" in err and "place panda-1 is as it was" in err
    assert [record["status"] for record in records()] == ["ok", "ok"]


@on_farm
def test_an_exporter_that_ended_before_is_said(farm, capsys):
    farm.end("exporter")
    try:
        assert main(write_target(farm, place="panda-1")) == 3
        assert "place panda-1: nobody offers bench/panda-1/*: the exporter bench ended" in capsys.readouterr().err
        Path("farm.yml").write_text(json.dumps(json.loads(Path("target.yml").read_text()) | {"place": "panda-1"}))
        assert main(["farm", "--target", "farm.yml", "--json"]) == 0
        (place,) = json.loads(capsys.readouterr().out)["places"]
        assert place["not_offered"] == ["bench/panda-1/*"] and place["console"] is None
    finally:
        farm.start("exporter")
        farm.await_resources(OFFERED)


@on_farm
def test_a_board_that_fails_its_check_twice_is_left_out_until_it_passes(farm, capsys, monkeypatch):
    """The place spare-1, which others find by healthy=yes, and whose SSH server has ended."""
    monkeypatch.setenv("LG_COORDINATOR", farm.coordinator)
    farm.client("-p", "panda-1", "set-tags", "pool=lab")
    farm.client("-p", "spare-1", "set-tags", "pool=lab")
    del farm.keys["host_key"]
    Path("known_hosts").write_text(
        "".join(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n" for sshd in (farm.sshd, farm.spare))
    )
    words = write_target(farm, filter={"pool": "lab"}, known_hosts="known_hosts", key=str(farm.sshd.key))

    def checked(status):
        assert main(["farm", "--target", "target.yml", "--check", "--json"]) == status
        printed = capsys.readouterr()
        checks = {check["place"]: check for check in json.loads(printed.out)["checks"]}
        return checks, farm.place("spare-1").tags

    farm.client("-p", "panda-1", "acquire", user="alice")
    farm.spare.process.kill()
    farm.spare.process.wait()
    checks, tags = checked(1)
    assert checks["panda-1"]["outcome"] == "not checked" and "held by" in checks["panda-1"]["text"]
    assert checks["spare-1"]["outcome"] == "failed" and "refused" in checks["spare-1"]["text"]
    assert "refused" in tags["failed_check"] and tags["healthy"] == "yes" and "quarantine" not in tags
    checks, tags = checked(1)
    assert checks["spare-1"]["outcome"] == "in quarantine" and "refused" in tags["quarantine"]
    assert tags["healthy"] == "no" and "failed_check" not in tags
    farm.client("-p", "panda-1", "release", user="alice")
    # It is free, and labgrid would lend it.
    assert main(words) == 0
    assert {record["target"]["name"] for record in records()} == {"panda-1"}
    assert [target.name for target in read_targets([], ["labgrid:pool=lab"])] == ["panda-1"]
    err = capsys.readouterr().err
    assert "place spare-1 is in quarantine: " in err and err.count("left out") == 1
    assert main(["archive", "add", "results/test", "--to", "archive"]) == 0
    capsys.readouterr()
    monkeypatch.setenv("COLUMNS", "220")
    assert main(["farm", "--archive", "archive"]) == 0
    first, _, *_ = (table := capsys.readouterr().out).splitlines()
    assert first == "3 places, 2 of them cannot be measured on"
    rows = {line.split()[0]: line for line in table.splitlines()[1:] if line.split()}
    assert "QUARANTINE: " in rows["spare-1"] and "(since 20" in rows["spare-1"] and "no switch" in rows["spare-1"]
    assert " free " in rows["panda-1"] and " yes " in rows["panda-1"] and "cyclic_timer" in rows["panda-1"]
    assert rows["spare-1"].endswith(" -") and "nobody offers" in rows["empty-1"]
    again = write_target(farm, place="spare-1", known_hosts="known_hosts", key=str(farm.sshd.key))
    assert main([*again, "--results", "other"]) == 3
    assert "place spare-1 is in quarantine: " in capsys.readouterr().err
    write_target(farm, filter={"pool": "lab"}, known_hosts="known_hosts", key=str(farm.spare.key))
    server = subprocess.Popen([SSHD, "-D", "-e", "-f", farm.spare.folder / "config"], stderr=subprocess.DEVNULL)
    try:
        checks, tags = checked(1)
    finally:
        server.kill()
        server.wait()
    assert checks["spare-1"]["outcome"] == "passed" and "its quarantine is over" in checks["spare-1"]["text"]
    assert tags == {"pool": "lab", "healthy": "yes"}


@on_farm
def test_who_has_the_higher_priority_has_a_place_first(farm):
    """alice holds it; bob waits for it since longer than rtrun does."""
    farm.client("-p", "panda-1", "acquire", user="alice")
    token = farm.client("reserve", "--shell", "name=panda-1", user="bob").partition("LG_TOKEN=")[2].strip()
    words = write_target(farm, place="panda-1", priority=5)
    helper = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.DEVNULL)
    while farm.client("reservations").count("owner:") < 2:
        time.sleep(0.1)
    farm.client("-p", "panda-1", "release", user="alice")
    try:
        assert helper.wait() == 0
    finally:
        farm.client("cancel-reservation", token)


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
        ({"place": "panda-9"}, 2, "has no place with name=panda-9; its places: empty-1, panda-1, spare-1"),
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
        labgrid_environment.read_environment(tmp_path / "env.yaml")


def test_labgrid_is_loaded_for_its_own_targets_only():
    code = (
        "import sys, rtrun.commands._boards\n"
        "sys.exit(any(name.split('.')[0] in ('labgrid', 'grpc', 'serial') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_tags_of_health():
    """Whatever a reason holds, a tag has none of it that ends a tag, and a passed check restores what was before."""
    tags = {"board": "panda", "healthy": "yes"}
    day = date(2026, 11, 24)
    for expected in ("failed_check", "quarantine"):
        changed = after_failure(tags, "10.0.0.7:22: refused;\n x=y, $(reboot) Ä" + 300 * "z", day)
        value = changed[expected]
        assert value.startswith("2026-11-24_10.0.0.7_22_refused_x_y_reboot_zz") and len(value) < 130
        assert in_words(value).endswith(" (since 2026-11-24)")
        tags = {name: text for name, text in (tags | changed).items() if text}
    assert tags.keys() == {"board", "healthy", "quarantine"} and tags["healthy"] == "no"
    assert after_failure(tags, "again", day) == {}
    restored = {name: text for name, text in (tags | after_success(tags)).items() if text}
    assert restored == {"board": "panda", "healthy": "yes"}
    assert after_success(restored) == {} and in_words("by hand") == "by hand"
