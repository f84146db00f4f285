"""Ctrl-C while something is kept."""

import os
import signal
import threading

import pytest

from rtfiles.interruption import deferred


def press():
    os.kill(os.getpid(), signal.SIGINT)


def test_the_first_one_waits_and_the_second_does_not(capfd):
    done = []
    with pytest.raises(KeyboardInterrupt), deferred("wait"):
        press()
        done.append("all of it")
    with pytest.raises(KeyboardInterrupt), deferred("wait"):
        press()
        press()
        done.append("never")
    assert done == ["all of it"] and capfd.readouterr().err == "wait\nwait\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_fails_says_so_all_the_same():
    with pytest.raises(ValueError, match="x"), deferred("wait"):
        press()
        raise ValueError("x")


def test_what_is_ignored_stays_so(capfd):
    """As in a background job of a shell, or in a thread that never gets it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with deferred("wait"):
            press()
    finally:
        signal.signal(signal.SIGINT, before)

    def work():
        with deferred("wait"):
            assert signal.getsignal(signal.SIGINT) is before

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert capfd.readouterr().err == ""
