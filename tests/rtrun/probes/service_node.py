"""Nodes on rclpy that tell the truth of a service: `server`, and `NAME CLIENTS COUNT AHEAD`.

Each client sends COUNT requests, one every 20 ms, even if AHEAD of its process have no answer yet. Printed at the end,
in nanoseconds of CLOCK_MONOTONIC: "call CLIENT NUMBER SENT RECEIVED" by clients, "work CLIENT NUMBER BEGIN END" by the
server, which ends with its standard input.
"""

import contextlib
import sys
import threading
import time

import rclpy
from rcl_interfaces.srv import GetParameterTypes
from rclpy.node import Node

rclpy.init()
name, *numbers = sys.argv[1:]
node = Node(name)
lines = []


def work(request: GetParameterTypes.Request, response: GetParameterTypes.Response) -> GetParameterTypes.Response:
    """Take a millisecond; for each tenth request longer than until the client's next one."""
    begin_ns, number = time.monotonic_ns(), int(request.names[1])
    time.sleep(0.03 if number % 10 == 3 else 0.001)
    lines.append(("work", *request.names, begin_ns, time.monotonic_ns()))
    return response


def send(client: int, number: int) -> None:
    """Send a request, and note when its answer is there."""
    sent_ns = time.monotonic_ns()
    future = clients[client].call_async(GetParameterTypes.Request(names=[f"{name}{client}", str(number)]))
    future.add_done_callback(lambda _: lines.append(("call", f"{name}{client}", number, sent_ns, time.monotonic_ns())))


if not numbers:
    node.create_service(GetParameterTypes, "types", work)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)
else:
    clients = [node.create_client(GetParameterTypes, "types") for _ in range(int(numbers[0]))]
    for client in clients:
        client.wait_for_service()
    # Whoever observes has found this program by then.
    sys.stdin.readline()
    sent, latest_ns = 0, time.monotonic_ns()

    def tick() -> None:
        """Each client sends its next request, unless many have no answer, and not for 0.1 s: some never get one."""
        global latest_ns, sent
        is_free = sent * len(clients) - len(lines) <= int(numbers[2]) or time.monotonic_ns() > latest_ns + 10**8
        if sent < int(numbers[1]) and is_free:
            for client in range(len(clients)):
                send(client, sent)
            sent, latest_ns = sent + 1, time.monotonic_ns()

    node.create_timer(0.02, tick)
    # Fast DDS may report a service before it has found both ends; such a request gets no answer.
    while len(lines) < len(clients) * int(numbers[1]) and time.monotonic_ns() < latest_ns + 5 * 10**9:
        rclpy.spin_once(node)
for line in lines:
    print(*line)
sys.stdout.flush()
