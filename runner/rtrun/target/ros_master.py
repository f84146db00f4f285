"""The ROS master: started where none answers, at a priority that cannot lock up the board, and ended after use."""

import contextlib
import http.client
import time
import xmlrpc.client
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from rtrun.plan.program import Program
from rtrun.target import processes
from rtrun.target.errors import ConnectionLost, StillMeasuring, TargetError
from rtrun.target.inspection import Equipment
from rtrun.target.link import Link
from rtrun.target.ssh import Connection

NAME = "rosmaster"
START_S = 60.0
ANSWER_S = 10.0
# A master whose runner was killed ends by itself after a week.
LIFE_S = 7 * 24 * 3600.0
CALLER = "/rtrun"


class _Tunnel(xmlrpc.client.Transport):
    """XML-RPC through the SSH connection, to a port that the target need not open to the network."""

    def __init__(self, connection: Connection, port: int) -> None:
        super().__init__()
        self._ssh, self._port = connection, port

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        name = host if isinstance(host, str) else host[0]
        link = http.client.HTTPConnection(name)
        channel = self._ssh.open_port(self._port)
        channel.settimeout(ANSWER_S)
        link.sock = channel  # It has every method of a socket that http.client uses.
        return link


def call(connection: Connection, port: int, method: str, *arguments: Any) -> Any:
    """Call the master's API and return the value of its answer.

    Raises ConnectionRefusedError when no master answers on the port, TargetError when it answers with a failure,
    ConnectionLost when the link broke.
    """
    proxy = xmlrpc.client.ServerProxy(f"http://127.0.0.1:{port}", transport=_Tunnel(connection, port))
    try:
        code, message, value = getattr(proxy, method)(CALLER, *arguments)
    except (ConnectionLost, ConnectionRefusedError):
        raise
    except (xmlrpc.client.Error, http.client.HTTPException, OSError, EOFError, ValueError, TypeError) as error:
        # A broken link must not be reported as a master that ended: ask whether the target still answers.
        connection.check_promptly(["true"], deadline_s=ANSWER_S)
        raise ConnectionRefusedError(f"port {port} does not answer as a ROS master: {error}") from error
    if code != 1:
        raise TargetError(f"{connection.address}: the ROS master refused {method}: {message}")
    return value


def ask_pid(link: Link) -> int | None:
    """Return the process id that the ROS master on the target's port reports; None when no master answers."""
    port = link.target.ros_master_port
    try:
        return int(link.do(lambda connection: call(connection, port, "getPid")))
    except (ConnectionRefusedError, ValueError, TypeError):
        return None


def count_subscribers(link: Link, topic: str, token: str) -> int:
    """Return how many nodes with a token in their names have subscribed. Raises TargetError when no master answers."""
    port = link.target.ros_master_port
    try:
        _, subscribed, _ = link.do(lambda connection: call(connection, port, "getSystemState"))
    except ConnectionRefusedError as error:
        raise TargetError(f"{link.target.address}: the ROS master died: {error}") from error
    return sum(token in node for name, nodes in subscribed if name == topic for node in nodes)


@contextlib.contextmanager
def running(
    link: Link, scripts: PurePosixPath, equipment: Equipment, owner: str, priority: int | None
) -> Iterator[bool]:
    """Make sure that a ROS master answers, and yield whether it is ours; ours is ended when the context is left.

    With `priority` it runs under FIFO at that priority, which must lie above that of every real-time node: on one CPU
    a node spins in ros::shutdown until the master answers, and a master below it never would (thesis 4.4).
    `owner` tells our master from one of another campaign.
    """
    target = link.target
    folder = target.work_dir / "master" / owner
    ours = _is_running(link, folder)
    if ask_pid(link) is None:
        if equipment.master is None:
            raise TargetError(
                f"{target.address}: no ROS on the target: neither /opt/ros/*/bin/rosmaster "
                "nor /usr/bin/rosmaster is there, install ROS with rosmaster"
            )
        processes.end(link, folder, NAME)
        link.check(["sh", "-c", 'rm -rf "$1" && mkdir -p "$1"', "sh", str(folder)])
        argv = [equipment.master, "--core", "-p", str(target.ros_master_port)]
        if priority is not None:
            argv = ["chrt", "-f", str(priority), *argv]
        program = Program(
            name=NAME,
            argv=tuple(argv),
            environment=(("ROS_IP", "127.0.0.1"), ("ROS_LOG_DIR", str(folder)), ("PYTHONDONTWRITEBYTECODE", "1")),
            deadline_s=LIFE_S,
        )
        ours = True
        processes.start(link, scripts, folder, program, setup=equipment.setup)
    try:
        if ours:
            _wait_ready(link, folder)
        yield ours
    except StillMeasuring:
        ours = False  # The run that goes on needs it: without a master it would hang in ros::shutdown.
        raise
    finally:
        if ours:
            with contextlib.suppress(TargetError):
                processes.end(link, folder, NAME)
                link.run(["rm", "-rf", str(folder)])


def _is_running(link: Link, folder: PurePosixPath) -> bool:
    lock = str(folder / f"{NAME}.lock")
    command = ["sh", "-c", '[ -e "$1" ] && ! flock -n "$1" true', "sh", lock]
    return link.run(command).status == 0


def _wait_ready(link: Link, folder: PurePosixPath) -> None:
    deadline = time.monotonic() + START_S
    while ask_pid(link) is None:
        if not _is_running(link, folder) or time.monotonic() >= deadline:
            last_line = processes.read_last_line(link, folder / f"{NAME}.stderr") or "it said nothing"
            raise TargetError(f"{link.target.address}: the ROS master did not start: {last_line}")
        time.sleep(0.1)
