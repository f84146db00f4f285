"""Print the graph of the nodes of ROS 2 that a program sees, as JSON: a node of rclpy joins its domain for seconds.

    python3 -I ros2_graph.py PID SECONDS

It takes the rights and the environment of the program, so it finds what that one finds. Nothing is published or
subscribed to, and no file is written. Exit status 3, with the reason as the last line: it cannot be done there.
For the target's own Python, 3.9 and later.
"""

import json
import os
import struct
import sys
import time
from pathlib import Path

NODE = "_rtrun_list"
ITSELF = "itself"
PAGES_BYTES = (4096, 16384, 65536)


def become(pid: str) -> None:
    """Begin anew as the user of a process, with its environment: this Python has read nothing of that yet."""
    # Of this process alone, whoever gets its number next.
    process = Path(f"/proc/self/fd/{os.open(f'/proc/{pid}', os.O_RDONLY | os.O_DIRECTORY)}")
    before = user, group, groups = rights(process)
    words = [word.partition(b"=") for word in (process / "environ").read_bytes().split(b"\0")]
    # The user may have no right to read the file.
    source = Path(__file__).read_text()
    environment = {key: value for key, equals, value in words if equals and key}
    # A program in Python knows where its packages are, as those of a virtual environment.
    called = os.fsdecode((process / "cmdline").read_bytes().partition(b"\0")[0])
    is_python = called.startswith("/") and (process / "exe").readlink().name.startswith("python")
    python = called if is_python else sys.executable
    if rights(process) != before:
        raise PermissionError("it was given other rights meanwhile")
    if os.geteuid() == 0:
        os.setgroups(groups)
        os.setgid(group)
        os.setuid(user)
    os.execve(python, [python, "-B", "-c", source, ITSELF, sys.argv[2]], environment)


def rights(process: Path) -> "tuple[int, int, list[int]]":
    """The user of a process, its group and further groups.

    Raises PermissionError where its rights are not those of its caller, who made its environment: as the caller likes
    he would have a Python of another user import what he has written.
    """
    status = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines() if ":" in line)
    users, groups = ({int(number) for number in status[key].split()} for key in ("Uid", "Gid"))
    if len(users) > 1 or len(groups) > 1 or is_secure((process / "auxv").read_bytes()):
        raise PermissionError("it was given other rights than its caller has (setuid, setgid, setcap)")
    return users.pop(), groups.pop(), [int(number) for number in status["Groups"].split()]


def is_secure(auxv: bytes) -> bool:
    """Whether the kernel gave a program other rights than its caller has, or does not tell: getauxval(3)."""
    page_bytes, secure = 6, 23
    for words in ("QQ", "II"):  # of 64 and 32 bits
        entries: dict[int, int] = dict(struct.iter_unpack(words, auxv[: len(auxv) // 16 * 16]))
        if entries.get(page_bytes) in PAGES_BYTES and secure in entries:
            return entries[secure] != 0
    return True


def graph(seconds: float) -> "list[dict[str, object]]":
    """The nodes that were seen within a time, with their topics and services."""
    import rclpy
    from rclpy.node import Node

    rclpy.init(args=["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs"])
    node = Node(NODE, start_parameter_services=False, enable_rosout=False)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.1)
    nodes: list[dict[str, object]] = []
    for name, space in sorted(set(node.get_node_names_and_namespaces())):
        asked = (
            node.get_publisher_names_and_types_by_node,
            node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node,
        )
        if name == NODE:
            continue
        publishes, takes, serves = ([topic for topic, _ in ask(name, space)] for ask in asked)
        full = f"{space.rstrip('/')}/{name}"
        nodes.append({"name": full, "publishes": publishes, "takes": takes, "serves": serves})
    return nodes


def main() -> None:
    """Print the graph once."""
    if sys.argv[1] != ITSELF:
        become(sys.argv[1])
    # On a line of its own: the middleware may have printed something.
    print("\n" + json.dumps({"nodes": graph(float(sys.argv[2]))}), flush=True)
    # Without what the middleware does at its end, which may take long.
    os._exit(0)


try:
    main()
except Exception as error:
    print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
    os._exit(3)
