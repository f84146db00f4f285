"""The life of a run: its states, the events that change them, and the one function that does."""

from collections.abc import Callable
from enum import StrEnum


class RunState(StrEnum):
    """Where a run is in its life. Only MEASURING survives the end of the runner: the target continues alone."""

    PLANNED = "planned"
    """The target has nothing of it."""
    STARTING = "starting"
    """It has a folder on the target, and perhaps running loads; nothing is measured yet."""
    LAUNCHING = "launching"
    """The measuring programs are about to be started; from now on they may run even if the runner is killed."""
    MEASURING = "measuring"
    """The programs of its suite were started."""
    OBSERVING = "observing"
    """The runner observes programs that belong to no suite; without it, nobody does."""
    ENDED = "ended"
    """The programs of its suite have ended; their files wait on the target."""
    CUT_OFF = "cut off"
    """The target was restarted before the run was closed."""
    CLOSED = "closed"
    """Its run directory is closed, with whatever status."""


class RunEvent(StrEnum):
    """An event that changes the state of a run."""

    BEGIN = "begin"
    LAUNCH = "launch"
    START = "start"
    OBSERVE = "observe"
    PICK_UP = "pick up"
    """An earlier call started it, and it still runs or waits to be closed."""
    END = "end"
    CLOSE = "close"
    GIVE_UP = "give up"
    """Its processes are ended, and its folder on the target is removed."""
    RESTART = "restart of the target"
    KEEP = "keep"
    """What a restart cut off is kept as incomplete."""


_NEXT = {
    (RunState.PLANNED, RunEvent.BEGIN): RunState.STARTING,
    (RunState.PLANNED, RunEvent.PICK_UP): RunState.MEASURING,
    (RunState.PLANNED, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.PLANNED, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.STARTING, RunEvent.LAUNCH): RunState.LAUNCHING,
    # A program that the suite needs has ended: the measuring programs are not started.
    (RunState.STARTING, RunEvent.START): RunState.MEASURING,
    (RunState.STARTING, RunEvent.OBSERVE): RunState.OBSERVING,
    (RunState.STARTING, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.STARTING, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.LAUNCHING, RunEvent.START): RunState.MEASURING,
    (RunState.LAUNCHING, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.LAUNCHING, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.OBSERVING, RunEvent.END): RunState.ENDED,
    (RunState.OBSERVING, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.OBSERVING, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.MEASURING, RunEvent.END): RunState.ENDED,
    (RunState.MEASURING, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.MEASURING, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.ENDED, RunEvent.CLOSE): RunState.CLOSED,
    (RunState.ENDED, RunEvent.RESTART): RunState.CUT_OFF,
    (RunState.CUT_OFF, RunEvent.KEEP): RunState.PLANNED,
    (RunState.CUT_OFF, RunEvent.GIVE_UP): RunState.PLANNED,
    (RunState.CUT_OFF, RunEvent.RESTART): RunState.CUT_OFF,
    # The restart came while the folder on the target was being removed.
    (RunState.CLOSED, RunEvent.RESTART): RunState.CLOSED,
}


class GivenUp(StrEnum):
    """Why an attempt was given up: the first words of the reason in the journal."""

    INTERRUPTED = "interrupted"
    """By the user, within the planned time."""
    NOT_MEASURED = "nothing was measured"
    TOO_LONG = "took longer than it may"
    LEFT = "left by an earlier call"
    """It is not known what it had measured."""


def transition(state: RunState, event: RunEvent) -> RunState:
    """Return the next state. Raises ValueError where the event cannot happen: a defect of the caller."""
    try:
        return _NEXT[state, event]
    except KeyError:
        raise ValueError(f"a run that is {state} cannot {event}") from None


class RunLife:
    """The state of one run; `note` is called with every new state and the reason for it."""

    def __init__(self, note: Callable[[RunState, str | None], None]) -> None:
        self.state = RunState.PLANNED
        self._note = note

    def move(self, event: RunEvent, reason: str | None = None) -> None:
        """Apply an event. Raises ValueError as `transition` does."""
        self.state = transition(self.state, event)
        self._note(self.state, reason)
