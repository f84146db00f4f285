"""Ctrl-C while something is kept that would be lost."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def deferred(said: str) -> Iterator[None]:
    """Let the first Ctrl-C wait for the end of the context, which then raises KeyboardInterrupt; a second acts at once.

    `said` is what the user reads meanwhile. Only the main thread gets Ctrl-C: in another one this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    # A shell lets what it starts in the background ignore Ctrl-C.
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    asked = threading.Event()

    def defer(_signal: int, _frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)
        # print may be what was interrupted.
        with contextlib.suppress(OSError):
            os.write(2, f"{said}\n".encode())

    signal.signal(signal.SIGINT, defer)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked.is_set():
        raise KeyboardInterrupt
