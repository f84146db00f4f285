"""The life of a run: which event may follow which state, and when an error ends what runs."""

import pytest

from rtrun.execution.run_execution import must_give_up, why_given_up
from rtrun.results.run_state import RunEvent, RunLife, RunState, transition
from rtrun.targets.errors import ConnectionLost, DeadlineExpired, TargetError, TargetGone
from rtrun.targets.link import TargetRebooted


def after(*events):
    states = []
    life = RunLife(lambda state, reason: states.append((state, reason)))
    for event in events:
        life.move(event)
    assert [state for state, _ in states[-1:]] == [life.state][: len(states)]
    return life.state


@pytest.mark.parametrize(
    ("events", "state"),
    [
        ("", "planned"),
        ("BEGIN START END CLOSE", "closed"),
        ("PICK_UP END CLOSE", "closed"),
        ("BEGIN GIVE_UP", "planned"),
        ("BEGIN START GIVE_UP BEGIN", "starting"),
        ("BEGIN LAUNCH", "launching"),
        ("BEGIN LAUNCH START END CLOSE", "closed"),
        ("BEGIN LAUNCH GIVE_UP", "planned"),
        ("BEGIN LAUNCH RESTART", "cut off"),
        ("BEGIN START RESTART", "cut off"),
        ("RESTART KEEP BEGIN START", "measuring"),
        ("BEGIN START END CLOSE RESTART", "closed"),
        ("BEGIN START END RESTART", "cut off"),
        ("BEGIN OBSERVE END CLOSE", "closed"),
        ("BEGIN OBSERVE GIVE_UP BEGIN", "starting"),
        ("BEGIN OBSERVE RESTART KEEP", "planned"),
    ],
)
def test_a_life(events, state):
    assert after(*(RunEvent[name] for name in events.split())) == state


@pytest.mark.parametrize(
    ("state", "event"),
    [
        (RunState.PLANNED, RunEvent.CLOSE),
        (RunState.MEASURING, RunEvent.CLOSE),
        (RunState.CUT_OFF, RunEvent.BEGIN),
        (RunState.CLOSED, RunEvent.BEGIN),
        (RunState.ENDED, RunEvent.GIVE_UP),
    ],
)
def test_what_cannot_happen_is_a_defect(state, event):
    with pytest.raises(ValueError, match=f"a run that is {state} cannot {event}"):
        transition(state, event)


@pytest.mark.parametrize(
    ("error", "states"),
    [
        (ConnectionLost("x"), ()),
        (TargetGone("x"), ()),
        (TargetRebooted("x"), ()),
        (TargetError("x"), (RunState.STARTING, RunState.LAUNCHING, RunState.OBSERVING)),
        (KeyboardInterrupt(), (RunState.STARTING, RunState.LAUNCHING, RunState.MEASURING, RunState.OBSERVING)),
        (DeadlineExpired("x"), (RunState.STARTING, RunState.LAUNCHING, RunState.MEASURING, RunState.OBSERVING)),
        (ZeroDivisionError(), ()),
    ],
)
def test_when_a_run_is_given_up(error, states):
    assert tuple(state for state in RunState if must_give_up(state, error)) == states


@pytest.mark.parametrize(
    ("state", "error", "taken_s", "reason"),
    [
        (RunState.MEASURING, DeadlineExpired("x"), 500, "took longer than it may: x"),
        (RunState.LAUNCHING, DeadlineExpired("x"), 5, "took longer than it may: x"),
        (RunState.MEASURING, KeyboardInterrupt(), 30, "interrupted"),
        (RunState.MEASURING, KeyboardInterrupt(), 31, "took longer than it may: interrupted after 31 s, of 10 s"),
        (RunState.LAUNCHING, TargetError("cannot fork"), 5, "nothing was measured: cannot fork"),
        (RunState.STARTING, DeadlineExpired("x"), 500, "nothing was measured: x"),
        (RunState.STARTING, KeyboardInterrupt(), 500, "interrupted"),
        (RunState.OBSERVING, KeyboardInterrupt(), 500, "interrupted"),
    ],
)
def test_who_interrupts_a_run_that_seems_to_hang_says_so(state, error, taken_s, reason):
    assert why_given_up(state, error, taken_s, 10) == reason


def test_every_state_is_noted_with_its_reason():
    noted = []
    life = RunLife(lambda *words: noted.append(words))
    life.move(RunEvent.BEGIN)
    life.move(RunEvent.GIVE_UP, "interrupted")
    assert noted == [(RunState.STARTING, None), (RunState.PLANNED, "interrupted")]
