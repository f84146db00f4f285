"""Ctrl-C while data would be lost."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def deferred(message: str) -> Iterator[None]:
    """Delay the first Ctrl-C to the end of the context, which then raises KeyboardInterrupt; a second acts at once.

    `message` is for the user meanwhile. Only the main thread gets Ctrl-C: in any other thread this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    # A shell makes background processes ignore Ctrl-C.
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    asked = threading.Event()

    def defer(_signal: int, _frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)
        # print itself may have been interrupted.
        with contextlib.suppress(OSError):
            os.write(2, f"{message}\n".encode())

    signal.signal(signal.SIGINT, defer)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked.is_set():
        raise KeyboardInterrupt
