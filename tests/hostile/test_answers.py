"""What a labgrid farm, a ROS master and a target's folders may answer: each wrong answer is an error of the target."""

import os
import time
from contextlib import closing
from pathlib import Path, PurePosixPath
from types import SimpleNamespace

import pytest

from rtfiles.errors import UsageError
from rtrun.execution import resumption
from rtrun.execution.middleware import roscpp
from rtrun.results import journal
from rtrun.targets.errors import TargetError
from rtrun.targets.labgrid import places as labgrid
from rtrun.targets.labgrid.resources import read_resources, ssh_service

SERVICE = "targets:\n  board:\n    resources:\n      NetworkService: {service}\n"


@pytest.mark.parametrize(
    ("printed", "message"),
    [
        ("targets: " + "[" * 20_000, "printed no environment"),
        ("targets: {board: {resources: " + "[" * 5000 + "]" * 5000 + "}}", "printed no environment"),
        (SERVICE.format(service="{username: root}"), "NetworkService: address: "),
        (SERVICE.format(service="{address: [1], username: root}"), "NetworkService: address: "),
        (SERVICE.format(service="{address: x, username: root, port: ssh}"), "NetworkService: port: "),
        (SERVICE.format(service="{address: x, username: root, port: 70000}"), "NetworkService: port: "),
        (SERVICE.format(service='{"\\ud800": x}'), "printed no environment"),
        (
            "targets:\n  board:\n    resources: {NetworkService: {a0: &a0 [x, x], "
            + ", ".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]" for n in range(30))
            + "}}",
            "printed no environment",
        ),
        ("targets: {board: {}}", "has no NetworkService"),
    ],
    ids=range(9),
)
def test_an_environment_that_names_no_board(printed, message):
    with pytest.raises(TargetError, match=message):
        ssh_service(read_resources(printed, "board"), "board")


def test_an_acquisition_that_never_ends_is_ended_and_given_back(tmp_path, monkeypatch):
    """The client waits for a coordinator that says nothing."""
    monkeypatch.setattr(labgrid, "CLIENT_S", 1.0)
    pid, released = tmp_path / "pid", []
    client = SimpleNamespace(
        identity="host/me",
        command=lambda *words: ["sh", "-c", 'echo $$ >"$0"; sleep 60', str(pid)],
        environment=dict(os.environ),
        call=lambda *words: released.append(words),
    )
    with pytest.raises(TargetError, match="place board was not acquired within 1 s"), labgrid._acquire(client, "board"):
        raise AssertionError("it was not acquired")
    assert released == [("-p", "board", "release-from", "host/me")]
    ended = Path(f"/proc/{pid.read_text().strip()}/cmdline")
    # Empty: it waits for whoever has to ask for its exit status.
    while ended.exists() and ended.read_bytes():
        time.sleep(0.05)


@pytest.mark.parametrize(("pid", "read"), [(True, None), ("12", None), (12, 12)])
def test_the_process_id_of_a_master_is_a_number(monkeypatch, pid, read):
    monkeypatch.setattr(roscpp, "call", lambda *_: pid)
    link = SimpleNamespace(target=SimpleNamespace(master_port=1), do=lambda action: action(None))
    assert roscpp.ask_pid(link) is read


@pytest.mark.parametrize("name", ["x" * 5000, "..", ".hidden", "a/b", "a\0b"])
def test_a_folder_of_no_run_is_nobodys(tmp_path, name):
    link = SimpleNamespace(check=lambda command, stdin: f"001-run\n{name}\n")
    assert resumption.list_folders(link, PurePosixPath("/runs/uid"), ["000-run", "001-run"]) == ["001-run"]
    with closing(journal.open_journal(tmp_path, "test", "2:plan", "board")) as log:
        log.note("now", "001-run", "starting")
        assert log.begun() == {"001-run"}
        log.note("now", name, "starting")
        with pytest.raises(UsageError, match="is no name of a run: the journal is damaged"):
            log.begun()
