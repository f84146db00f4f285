"""The QEMU machine protocol: just enough to ask a board in QEMU something and to pull its plug."""

import json
import socket
from pathlib import Path
from typing import Any

from rtrun.targets.errors import TargetGone


def execute(path: Path, command: str, arguments: dict[str, Any] | None = None, *, timeout_s: float = 10.0) -> Any:
    """Run one QMP command on the monitor socket at `path` and return its result.

    Raises TargetGone when the emulator does not answer.
    """
    try:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(timeout_s)
            link.connect(str(path))
            with link.makefile("rwb") as stream:
                stream.readline()
                _ask(stream, "qmp_capabilities", {})
                return _ask(stream, command, arguments or {})
    except (OSError, ValueError) as error:
        raise TargetGone(f"the emulator does not answer on its monitor: {error}") from error


def _ask(stream: Any, command: str, arguments: dict[str, Any]) -> Any:
    stream.write(json.dumps({"execute": command, "arguments": arguments}).encode() + b"\n")
    stream.flush()
    while line := stream.readline():
        answer = json.loads(line)
        if "return" in answer:
            return answer["return"]
        if "error" in answer:
            raise ValueError(answer["error"].get("desc", "refused"))
    if command == "quit":
        return {}
    raise ValueError("it closed the connection")
