"""What a serial port behind TCP prints, kept in a file."""

import contextlib
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_READ_S = 0.5
_RETRY_S = 1.0


@contextlib.contextmanager
def keeping_console(port: Mapping[str, Any], path: Path) -> Iterator[None]:
    """Append what a serial port prints to a file while the context lasts."""
    scheme = "socket" if port.get("protocol") == "raw" else "rfc2217"
    url = f"{scheme}://{port['host']}:{port['port']}"
    ended = threading.Event()

    def keep() -> None:
        import serial

        while not ended.is_set():
            # The exporter, or the power switch of the board, may take the port away for a time.
            with (
                contextlib.suppress(OSError, serial.SerialException),
                serial.serial_for_url(url, baudrate=int(port.get("speed") or 115200), timeout=_READ_S) as stream,
            ):
                while not ended.is_set():
                    if data := stream.read(max(1, stream.in_waiting)):
                        with path.open("ab") as log:
                            log.write(data)
            ended.wait(_RETRY_S)

    path.touch()
    reader = threading.Thread(target=keep, daemon=True)
    reader.start()
    try:
        yield
    finally:
        ended.set()
        reader.join(2 * _READ_S + _RETRY_S)
