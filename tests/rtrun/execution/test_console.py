"""The console of an emulated board, which a hostile kernel can fill without end: only its end is read."""

from dataclasses import replace

import pytest
from faulty import measure, runs_of

from ports import free_port
from rtrun.execution import closing
from rtrun.targets.errors import ConnectionLost
from rtrun.targets.link import CONSOLE_END_BYTES, Link

pytestmark = [pytest.mark.sshd, pytest.mark.ros]


@pytest.fixture
def console(tmp_path):
    path = tmp_path / "console.log"
    path.write_bytes(b"x" * 10 * CONSOLE_END_BYTES + b"\nKernel panic\n" + b"y" * 10 * CONSOLE_END_BYTES)
    return path


def test_a_board_that_is_gone_shows_the_end_of_its_console(target, console):
    gone = replace(target, address=replace(target.address, port=free_port()), console=console, reconnect_s=0)
    with pytest.raises(ConnectionLost, match=r"its console ended with: 'y+'") as caught, Link(gone, print):
        pass
    assert str(caught.value).count("y") < CONSOLE_END_BYTES + 100


def test_a_run_keeps_the_end_of_the_console(ready_target, tmp_path, wishes, console, monkeypatch):
    monkeypatch.setattr(closing, "CONSOLE_LIMIT_BYTES", 5000)
    (run,) = runs_of(1)
    target = replace(ready_target, console=console)
    assert measure(target, [run], tmp_path / "results") == ["ok"]
    assert (tmp_path / "results" / run.name / "console.log").read_bytes() == b"y" * 5000
