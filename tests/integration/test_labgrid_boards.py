"""Two boards in QEMU as places of a labgrid farm: a campaign on both, one of which dies and is switched on again."""

import contextlib
import json
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import rtgen.cli
from rtrun.results.record import RunStatus, verify
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost
from rtrun.targets.qemu import emulator as qemu

pytest.importorskip("labgrid", reason="the extra farm is not installed")
from labgrid_farm import farm_of, power_switch

pytestmark = [pytest.mark.qemu, pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(1800)]
TOP = Path(__file__).parents[2]
PLACES = ("qemu-1", "qemu-2")
CAMPAIGN = """
schema: 1
name: farm
runs: [{suite: cyclic_timer_tests, frequency_hz: 50, repetitions: 500, policy: RR, repeats: 4}]
"""


def await_answer(machine):
    """Connect to a board that boots."""
    deadline = time.monotonic() + 600
    while True:
        try:
            return Connection(machine.address, timeout_s=10)
        except ConnectionLost:
            assert machine.failure() is None and time.monotonic() < deadline
            time.sleep(1)


def is_measuring(connection):
    return connection.run(["sh", "-c", "ls /var/lib/rt-tests/runs/*/*/cyclic_timer_tests.pid"]).status == 0


def test_two_boards_share_a_campaign_and_a_dead_one_is_switched_on_again(tmp_path, monkeypatch):
    monkeypatch.chdir(TOP)
    assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    assert rtgen.cli.main(["suites", "build", "--machine", "qemu-armv7"]) == 0
    board, suites = TOP / "build/board/qemu-armv7", TOP / "build/suites/qemu-armv7"
    monkeypatch.chdir(tmp_path)
    switched = {place: [] for place in PLACES}
    with contextlib.ExitStack() as stack:
        # QEMU ends with the thread that started it, and each request to a switch is in a thread of its own.
        starting = stack.enter_context(ThreadPoolExecutor(1))
        machines = {place: stack.enter_context(qemu.boot(board, tmp_path / f"{place}.console")) for place in PLACES}
        resources = {}
        for place, machine in machines.items():

            def switch(is_on, place=place, machine=machine):
                switched[place].append(is_on)
                starting.submit(machine.start if is_on else machine.end).result()

            service = {"address": "127.0.0.1", "port": machine.port, "username": machine.address.user}
            power = stack.enter_context(power_switch(switch))
            resources[place] = {"NetworkService": service, "NetworkPowerPort": power}
        farm = stack.enter_context(farm_of(tmp_path, resources, {"board": "qemu"}))
        connections = {place: await_answer(machine) for place, machine in machines.items()}
        for number, machine in enumerate(machines.values()):
            login = {"key": str(machine.address.key), "host_key": machine.address.host_key}
            keys = {"kind": "labgrid", "filter": {"board": "qemu"}, "coordinator": farm.coordinator, **login}
            keys |= {"suites": str(suites), "emulated": True, "reconnect_s": 3, "boot_s": 600}
            Path(f"{number}.yml").write_text(json.dumps({"schema": 1, "name": f"board-{number}", **keys}))
        Path("campaign.yml").write_text(CAMPAIGN)
        command = [sys.executable, "-m", "rtrun.cli", "run", "campaign.yml", "--target", "0.yml", "--target", "1.yml"]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        lines = []
        reader = threading.Thread(target=lambda: lines.extend(process.stderr))
        reader.start()
        while not is_measuring(connections["qemu-2"]):
            assert process.poll() is None, "".join(lines)
            time.sleep(1)
        machines["qemu-2"].end()
        assert process.wait(1200) == 0, "".join(lines)
        reader.join()
        assert "switching its power off and on" in "".join(lines)
        assert not any(farm.place(place).holder or farm.place(place).reservation for place in PLACES)
    assert switched == {"qemu-1": [], "qemu-2": [False, True]}
    records = [verify(path.parent) for path in Path("results/farm").glob("0*/run.json")]
    assert len(records) == 4 and {record.status for record in records} == {RunStatus.OK}
    assert {record.target.name for record in records} == set(PLACES)
