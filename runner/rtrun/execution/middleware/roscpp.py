"""roscpp: its programs need a ROS master, which also knows who has subscribed.

If no master answers, one is started, at a priority that cannot lock up the board, and ended after use.
"""

import contextlib
import http.client
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from pathlib import PurePosixPath
from typing import Any

from rtfiles.errors import InfrastructureError
from rtrun.execution.middleware.service import Service
from rtrun.kinds.limits import PID_MAX
from rtrun.plan.program import Program
from rtrun.targets import processes
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.facts import Installed
from rtrun.targets.link import Link

NAME = "rosmaster"
START_S = 60.0  #: start of a ROS master
ANSWER_S = 10.0  #: an answer of the ROS master
REPLY_BYTES_MAX = 4 * 1024 * 1024  #: such an answer
LIFE_S = 7 * 24 * 3600.0  #: life of a ROS master whose runner was killed, a week
CALLER = "/rtrun"
TOPIC = "/communication_tests"


def call(connection: Connection, port: int, method: str, *arguments: Any) -> Any:
    """Call the master's API and return the value of its answer.

    Raises ConnectionRefusedError when no master answers on the port, TargetError when it answers with a failure,
    ConnectionLost when the link broke.
    """
    request = xmlrpc.client.dumps((CALLER, *arguments), method).encode()
    try:
        with connection.open_port(port, deadline_s=ANSWER_S) as channel:
            reply = _post(channel, request)
        code, message, value = _parse_reply(reply)
    except (InfrastructureError, ConnectionRefusedError):
        raise
    except (http.client.HTTPException, OSError, EOFError, ValueError) as error:
        # A broken link must not be reported as a master that ended: ask whether the target still answers.
        connection.check_promptly(["true"], deadline_s=ANSWER_S)
        raise ConnectionRefusedError(f"port {port} does not answer as a ROS master: {error}") from error
    if code != 1:
        raise TargetError(f"{connection.address}: the ROS master refused {method}: {message[:200]}")
    return value


def _post(channel: Any, request: bytes) -> bytes:
    """Send an XML-RPC request over an open stream and return the reply."""
    link = http.client.HTTPConnection("127.0.0.1")
    link.sock = channel  # It has every method of a socket that http.client uses.
    link.request("POST", "/RPC2", request, {"Content-Type": "text/xml"})
    response = link.getresponse()
    reply = response.read(REPLY_BYTES_MAX + 1)
    if response.status != http.client.OK or len(reply) > REPLY_BYTES_MAX:
        raise ValueError(f"HTTP status {response.status}, {len(reply)} bytes")
    return reply


def _parse_reply(reply: bytes) -> tuple[int, str, Any]:
    """Return code, message and value of a reply of the ROS master. Raises ValueError."""
    # No master defines entities, which could expand a short reply to a very long one.
    if b"<!" in reply or b"\0" in reply:
        raise ValueError("not an XML-RPC reply")
    try:
        values: Any = xmlrpc.client.loads(reply)[0]
        ((code, message, value),) = values
    except Exception as error:
        # xmlrpc.client raises whatever its parsing of the reply raises.
        raise ValueError(f"not an XML-RPC reply: {error}") from error
    if not isinstance(code, int) or not isinstance(message, str):
        raise ValueError("not the reply of a ROS master")
    return code, message, value


def ask_pid(link: Link) -> int | None:
    """Return the process id that the ROS master on the target's port reports; None when no master answers."""
    port = link.target.master_port
    try:
        pid = link.do(lambda connection: call(connection, port, "getPid"))
    except ConnectionRefusedError:
        return None
    # True is an int, too.
    return pid if type(pid) is int and 1 <= pid <= PID_MAX else None


def count_subscribers(link: Link, token: str) -> int:
    """Return how many nodes with a token in their names have subscribed. Raises TargetError when no master answers."""
    port = link.target.master_port
    try:
        _, subscribed, _ = link.do(lambda connection: call(connection, port, "getSystemState"))
        return sum(token in node for name, nodes in subscribed if name == TOPIC for node in nodes)
    except ConnectionRefusedError as error:
        raise TargetError(f"{link.target.address}: the ROS master died: {error}") from error
    except (TypeError, ValueError) as error:
        raise TargetError(f"{link.target.address}: the ROS master's answer has no list of topics") from error


@contextlib.contextmanager
def running(
    link: Link,
    scripts: PurePosixPath,
    installed: Installed,
    owner: str,
    priority: int | None,
    may_run_go_on: Callable[[], bool],
) -> Iterator[bool]:
    """Make sure that a ROS master answers, and yield whether it is ours; ours is ended when the context is left.

    Our master stays if a run may go on: without it the run would hang in ros::shutdown.

    With `priority` it runs under FIFO at that priority, which must lie above that of every real-time node: on one CPU a
    node spins in ros::shutdown until the master answers, and a master below it never would (thesis 4.4). `owner`
    distinguishes our master from that of another campaign.
    """
    target = link.target
    folder = target.work_dir / "master" / owner
    ours = _is_running(link, folder)
    if ask_pid(link) is None:
        if installed.server is None:
            raise TargetError(
                f"{target.address}: no ROS on the target: neither /opt/ros/*/bin/rosmaster "
                "nor /usr/bin/rosmaster is there, install ROS with rosmaster"
            )
        processes.end(link, folder, NAME)
        if _is_port_taken(link):
            raise TargetError(
                f"{target.address}: port {target.master_port} of the target is taken by a program that does not "
                "answer as a ROS master: end it, or put another ros_master_port into the target file"
            )
        link.check(["sh", "-c", 'rm -rf "$1" && mkdir -p "$1"', "sh", str(folder)])
        argv = [installed.server, "--core", "-p", str(target.master_port)]
        if priority is not None:
            argv = ["chrt", "-f", str(priority), *argv]
        program = Program(
            name=NAME,
            argv=tuple(argv),
            environment=(("ROS_IP", "127.0.0.1"), ("ROS_LOG_DIR", str(folder)), ("PYTHONDONTWRITEBYTECODE", "1")),
            deadline_s=LIFE_S,
        )
        ours = True
        processes.start(link, scripts, folder, program, setup=installed.setup)
    try:
        if ours:
            _wait_ready(link, folder)
        yield ours
    finally:
        if ours:
            with contextlib.suppress(TargetError):
                if not may_run_go_on():
                    processes.end(link, folder, NAME)
                    link.run(["rm", "-rf", str(folder)])


# If the lock is taken, locking fails silently. If locking itself fails, it is unknown whether the master runs.
_LOCKED = '[ ! -e "$1" ] || message=$(flock -n "$1" true 2>&1) || echo "taken $message"'


def _is_running(link: Link, folder: PurePosixPath) -> bool:
    taken, _, message = link.check(["sh", "-c", _LOCKED, "sh", str(folder / f"{NAME}.lock")]).strip().partition(" ")
    if message:
        raise TargetError(f"{link.target.address}: whether the ROS master runs is not known: {message[:200]}")
    return taken == "taken"


def _is_port_taken(link: Link) -> bool:
    def connect(connection: Connection) -> bool:
        with connection.open_port(link.target.master_port, deadline_s=ANSWER_S):
            return True

    try:
        return link.do(connect)
    except ConnectionRefusedError:
        return False


def _wait_ready(link: Link, folder: PurePosixPath) -> None:
    # A board that may take long to boot may take as long to start a Python program.
    deadline = time.monotonic() + max(START_S, link.target.boot_s)
    while ask_pid(link) is None:
        if not _is_running(link, folder) or time.monotonic() >= deadline:
            last_line = processes.read_last_line(link, folder / f"{NAME}.stderr") or "it said nothing"
            raise TargetError(f"{link.target.address}: the ROS master did not start: {last_line}")
        time.sleep(0.1)


def _identity(link: Link) -> str | None:
    pid = ask_pid(link)
    return None if pid is None else str(pid)


SERVICE = Service(
    name="the ROS master",
    running=running,
    identity=_identity,
    count_subscribers=count_subscribers,
)
