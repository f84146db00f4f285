"""The link under faults: a stand-in for the connection refuses, breaks, or comes back as another boot."""

from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest

from rtrun.targets import link as link_module
from rtrun.targets.address import Address
from rtrun.targets.config import Power, Target
from rtrun.targets.errors import ConnectionLost, TargetGone
from rtrun.targets.link import BREAKS_MAX, CONNECT_BOOTING_S, CONNECT_MAX_S, CONNECT_S, RETRY_S, Link, TargetRebooted

TARGET = Target(
    name="board",
    address=Address(host="board", port=22, user="root", key=Path("key"), host_key=None),
    suites=None,
    work_dir=PurePosixPath("/work"),
    setup=None,
    master_port=11311,
    reconnect_s=60,
)


class Board:
    """What the connections to a board meet, and what they did."""

    def __init__(self):
        self.refuses = False
        self.boot_id = "boot 1"
        self.timeouts_s = []
        self.closed = 0
        self.slept_s = 0.0
        self.at = lambda now_s: None
        """What happens to it as time goes by."""


@pytest.fixture
def board(monkeypatch):
    board = Board()

    class Connection:
        def __init__(self, address, *, timeout_s):
            board.timeouts_s.append(timeout_s)
            if board.refuses:
                raise ConnectionLost("refused")

        def check_promptly(self, argv):
            if not board.boot_id:
                raise ConnectionLost("no answer")
            return board.boot_id

        def close(self):
            board.closed += 1

    class Time:
        @staticmethod
        def monotonic():
            return board.slept_s

        @staticmethod
        def sleep(seconds):
            board.slept_s += seconds
            board.at(board.slept_s)

    monkeypatch.setattr(link_module, "Connection", Connection)
    monkeypatch.setattr(link_module, "time", Time)
    return board


def breaks(_):
    raise ConnectionLost("the connection broke")


def test_a_step_that_breaks_every_connection_is_given_up(board, remarks):
    with Link(TARGET, remarks.append) as link:
        with pytest.raises(ConnectionLost, match=f"this was the {BREAKS_MAX}th connection to break at the same step"):
            link.do(breaks)
        assert len(board.timeouts_s) == board.closed == BREAKS_MAX
        assert remarks == ["the connection broke; connecting again"] * (BREAKS_MAX - 1)
        assert link.do(lambda _: "fine") == "fine", "another step begins to count anew"


@pytest.mark.parametrize("refuses", [False, True])
def test_a_board_that_is_known_to_be_gone_is_not_waited_for(board, remarks, refuses):
    gone = []
    with Link(replace(TARGET, failure=lambda: gone[0] if gone else None), remarks.append) as link:

        def leave(_):
            board.refuses = refuses
            if not refuses:
                gone.append(TargetGone("QEMU ended"))
            raise ConnectionLost("the connection broke")

        if refuses:
            link.note = lambda _: gone.append(TargetGone("QEMU ended"))
        with pytest.raises(TargetGone, match="QEMU ended"):
            link.do(leave)
    assert board.slept_s == 0


@pytest.mark.parametrize(
    ("boot_s", "first_s", "later_s", "timeout_s"), [(0, 0, 60, CONNECT_S), (90, 90, 90, CONNECT_BOOTING_S)]
)
def test_how_long_a_board_is_waited_for(board, remarks, boot_s, first_s, later_s, timeout_s):
    """At first it may still boot, if it was started for this; later it may also have been restarted."""
    target = replace(TARGET, boot_s=boot_s)
    board.refuses = True
    with pytest.raises(ConnectionLost, match="refused"):
        Link(target, remarks.append).__enter__()
    assert first_s <= board.slept_s <= first_s + RETRY_S
    assert board.timeouts_s[0] == timeout_s
    # Longer and longer, as the board may be slow to answer.
    assert board.timeouts_s == sorted(board.timeouts_s) and board.timeouts_s[-1] == (
        CONNECT_MAX_S if boot_s else timeout_s
    )
    board.refuses, board.slept_s = False, 0.0
    with Link(target, remarks.append) as link:
        link.drop()
        board.refuses = True
        with pytest.raises(ConnectionLost, match=f"refused, tried for {later_s} s"):
            link.run(["true"])
        assert later_s <= board.slept_s <= later_s + RETRY_S
        board.refuses, board.slept_s = False, 0.0
        with pytest.raises(ConnectionLost, match=f"refused, tried for {later_s} s"):
            link.run(["rm", "-rf", "/work"])
        assert board.slept_s == 0, "cleaning up does not wait a second time"


def test_a_restart_is_told_once(board, remarks):
    with Link(TARGET, remarks.append) as link:
        link.drop()
        board.boot_id = "boot 2"
        with pytest.raises(TargetRebooted, match="another boot id"):
            link.do(lambda _: None)
        assert link.boot_id == "boot 2"
        assert link.do(lambda _: "fine") == "fine"
        assert len(board.timeouts_s) == 2, "the connection by which it was found out is used"
        link.drop()
        assert link.do(lambda _: "fine") == "fine"


@pytest.mark.parametrize(("boots_within_s", "cycles"), [(80, 0), (100, 1)])
def test_a_restart_on_purpose_has_the_time_that_the_board_boots_in(board, remarks, boots_within_s, cycles):
    """A farm lends the board and its power switch: before, the switch cut the power while the board booted."""
    switched = []

    def cycle():
        switched.append(board.slept_s)

    target = replace(TARGET, reconnect_s=5, power=Power(cycle=cycle, boot_s=90), restart=lambda _: None)
    with Link(target, remarks.append) as link:
        link.expect_boot()
        link.drop()
        board.refuses = True
        board.at = lambda now_s: now_s >= boots_within_s and setattr(board, "refuses", False)
        board.boot_id = "boot 2"
        with pytest.raises(TargetRebooted):
            link.do(lambda _: None)
        assert len(switched) == cycles
        # A connection that is not asked for has only the time for connecting again.
        link.drop()
        board.refuses, answers_s = True, board.slept_s + 30
        board.at = lambda now_s: now_s >= answers_s and setattr(board, "refuses", False)
        link.do(lambda _: None)
        assert len(switched) == cycles + 1


def test_a_connection_without_a_boot_is_closed(board, remarks):
    board.boot_id = ""
    with pytest.raises(ConnectionLost, match="no answer"):
        Link(TARGET, remarks.append).__enter__()
    assert board.closed == 1
