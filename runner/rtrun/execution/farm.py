"""Several boards measure one campaign at a time, each in a thread of its own."""

import contextlib
import functools
import sys
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from rtfiles.errors import InfrastructureError
from rtrun.execution.allotment import Allotment, NextRound, Round
from rtrun.execution.board import Observer, Session, measure_rounds
from rtrun.targets.config import Target
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.link import Link


class BoardObserver(Observer, Protocol):
    """Shows the user the progress of one of several boards."""

    def left(self, error: str | None) -> None:
        """The board measures no more: the campaign is over, or, with an error, the board cannot go on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A target that is not switched on yet: `connect` boots or acquires it for as long as its context lasts.

    The argument of `connect` tells whether the campaign is over, so that it does not wait any longer.
    """

    name: str
    connect: Callable[[Callable[[], bool]], AbstractContextManager[Target]]
    observer: BoardObserver


def measure_on_boards(session: Session, boards: Sequence[Board], next_round: NextRound) -> None:
    """Measure rounds on whichever board is free, until there are no more.

    A board that fails leaves its runs to the others. An error in the campaign or in the program itself ends the work
    on all boards. Raises TargetError when no board is left, KeyboardInterrupt once every board has cleaned up, and
    InfrastructureError when this machine cannot store a run, once the boards have finished theirs.
    """
    # A thread computes for milliseconds and then waits for its board. Python's default, to switch threads every 5 ms,
    # costs CPU time and gains nothing.
    sys.setswitchinterval(0.05)
    allotment = Allotment(next_round, [board.name for board in boards], session.owners)
    work = _FarmThreads(session=session, allotment=allotment)
    # A second Ctrl-C ends the program at once: it waits for no thread.
    for board in boards:
        threading.Thread(target=work.measure_on, args=(board,), daemon=True).start()
    try:
        work.wait(len(boards))
    except KeyboardInterrupt:
        work.stop()
        work.wait(len(boards))
        raise
    for error in work.errors.values():
        if _is_of_this_machine(error) or not isinstance(error, InfrastructureError | KeyboardInterrupt):
            raise error
    if len(work.errors) == len(boards):
        # A problem common to all boards, such as a coordinator that does not answer, is reported once.
        names: dict[str, list[str]] = {}
        for name, error in work.errors.items():
            if name not in work.reported:
                names.setdefault(str(error), []).append(name)
        raise TargetError("\n".join(f"{', '.join(board_names)}: {text}" for text, board_names in names.items()))


def _is_of_this_machine(error: BaseException) -> bool:
    """Whether this machine failed, not a board: another board would measure the run again, and could not store it."""
    causes = (error, error.__cause__)  # the TargetError of a run that goes on has the real error as its cause
    return any(isinstance(cause, InfrastructureError) and not isinstance(cause, TargetError) for cause in causes)


class _FarmThreads:
    """State that the threads share: the errors that ended boards, and the means to end them all."""

    def __init__(self, session: Session, allotment: Allotment) -> None:
        self.errors: dict[str, BaseException] = {}
        self.reported: set[str] = set()
        """The boards reported to have left their runs to another one that works."""
        self._waiting: dict[str, Callable[[], None]] = {}
        """By board: reports that it left its runs to others. Called once another board works."""
        self._working: set[str] = set()
        self._session, self._allotment = session, allotment
        self._links: list[Link] = []
        self._lock = threading.Lock()
        self._changed = threading.Condition()
        self._ended = 0
        self._is_stopped = False

    def measure_on(self, board: Board) -> None:
        """Measure on a board until nothing is left for it, or it fails."""
        error: BaseException | None = None
        try:
            with board.connect(lambda: self._allotment.is_over) as target:
                link = Link(target, board.observer.note)
                with self._lock:
                    self._links.append(link)
                    if self._is_stopped:
                        link.interrupt()

                def take(begun: Collection[str]) -> Round | None:
                    self._say_waiting(board)
                    return self._allotment.take(board.name, begun)

                measure_rounds(self._session, link, board.observer, take)
        except BaseException as raised:
            if isinstance(raised, TargetGone) and self._allotment.is_over:
                # The wait for the board took too long: the campaign is over.
                return
            # The thread that waits for all boards decides what the error means for them.
            error = self.errors[board.name] = raised
            if _is_of_this_machine(raised):
                self._allotment.end()
            elif not isinstance(raised, InfrastructureError):
                self.stop()
        finally:
            self._allotment.withdraw(board.name)
            with contextlib.suppress(Exception):
                is_shown = isinstance(error, InfrastructureError) and not _is_of_this_machine(error)
                self._say_left(board, str(error) if is_shown else None)
            with self._changed:
                self._ended += 1
                self._changed.notify_all()

    def wait(self, boards: int) -> None:
        """Wait until this many boards have ended.

        Thread.join does not work here: after a KeyboardInterrupt within it, Python 3.11 treats the thread as ended.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._ended == boards)

    def _say_waiting(self, board: Board) -> None:
        """Report which boards left their runs to others, now that this board works and asks for runs."""
        with self._lock:
            self._working.add(board.name)
            waiting, self._waiting = self._waiting, {}
            self.reported |= waiting.keys()
        for say in waiting.values():
            say()

    def _say_left(self, board: Board, error: str | None) -> None:
        """Report that a board measures no more. If it failed, the report waits until another board works."""
        with self._lock:
            self._working.discard(board.name)
            if error is not None and not self._working:
                self._waiting[board.name] = functools.partial(board.observer.left, error)
                return
            if error is not None:
                self.reported.add(board.name)
        board.observer.left(error)

    def stop(self) -> None:
        """Let every board clean up and end."""
        self._allotment.stop()
        with self._lock:
            if not self._is_stopped:
                self._is_stopped = True
                for link in self._links:
                    link.interrupt()
