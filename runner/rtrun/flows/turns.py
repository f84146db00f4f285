"""The turns of each thread, one after another: a message or a timer, from when the thread took it until it had handled
it."""

from collections.abc import Callable
from typing import NamedTuple

from rtrun.causes.ftrace import CALLBACK_CHARACTERS_MAX
from rtrun.flows.messages import Endpoint, Reception
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import LivingProcess, LivingThing, numbered
from rtrun.flows.threads import ObservedThread, OpenTurn
from rtrun.flows.timers import LivingTimer, TimerCall, timer_name
from rtrun.probes.hits import Hit

_ENDS = frozenset(("take", "timer_call", "callback_begin", "wait", "request_take", "response_take"))


class Turn(NamedTuple):
    """A callback of a thread; `name` has its timer or topic, and its node; `end_ns` is None if it was not seen."""

    begin_ns: int
    end_ns: int | None
    cpu: int
    pid: int
    tid: int
    name: str


class TurnRecord:
    """Reports the turns of each thread, in the order in which their ends become known.

    A turn ends at the probe for the end of a callback (rclcpp), or at the last guard condition that rclpy triggers. In
    C, if the thread is seen to wait, its turn ends when it waits or takes the next message. In roscpp no end is seen.
    """

    def __init__(self, on_turn: Callable[[Turn], None], state: ObservationState) -> None:
        self._on_turn = on_turn
        self._label = state.label

    def see(self, hit: Hit, thread: ObservedThread) -> None:
        """Take a hit, after the thread has taken it."""
        event, turn = hit.event, thread.turn
        if event == "guard_trigger" and turn is not None:
            turn.triggers, turn.triggered_ns = turn.triggers + 1, hit.at_ns
        elif event == "callback_begin" and turn is not None and not turn.has_callback and _is_direct(thread):
            turn.has_callback, turn.awaits_callback = True, False
        elif event == "callback_end" and turn is not None:
            self._end(turn, thread, hit.at_ns)
        elif event in _ENDS:
            is_queued = event == "callback_begin" and "topic" not in hit.values
            if turn is not None and not turn.has_callback and (turn.awaits_callback or is_queued):
                # It was discarded, or its callback runs elsewhere.
                thread.turn = None
            elif turn is not None:
                self._end(turn, thread, _end_ns(turn, hit, thread))
            # Each thread keeps one name, and many are kept for ended turns.
            name = self._name(hit, thread)[:CALLBACK_CHARACTERS_MAX]
            if name:
                is_callback = event == "callback_begin"
                awaits = not is_callback and "is_begin" not in hit.values and thread.process.shows_callbacks
                has_callback = is_callback and "topic" not in hit.values
                thread.turn = OpenTurn(hit.at_ns, hit.cpu, name, has_callback, awaits)

    def _end(self, turn: OpenTurn, thread: ObservedThread, end_ns: int | None) -> None:
        thread.turn = None
        self._on_turn(Turn(turn.begin_ns, end_ns, turn.cpu, thread.process.pid, thread.tid, turn.name))

    def _name(self, hit: Hit, thread: ObservedThread) -> str:
        """The name of the turn that begins with a hit; empty if none does."""
        if hit.event == "callback_begin":
            topic = hit.values.get("topic")
            if isinstance(topic, str):
                return f"{topic} of {self._label(thread.process, thread.process.label)}"
            owner = thread.callbacks[-1].callback.owner if thread.callbacks else None
            return self._name_of(owner, thread.process)
        if isinstance(thread.cause, TimerCall) and hit.event == "timer_call":
            return self._name_of(thread.cause.timer, thread.process)
        if isinstance(thread.cause, Reception) and hit.event == "take":
            return self._name_of(thread.cause.endpoint, thread.process)
        return ""

    def _name_of(self, owner: LivingThing | None, process: LivingProcess) -> str:
        if isinstance(owner, Endpoint):
            return f"{owner.topic} of {owner.end.label}"
        if not isinstance(owner, LivingTimer):
            return f"a callback of {self._label(process, process.label)}"
        if owner.log is None:  # as its log will have it
            return f"{timer_name(owner.period_ns)} of {self._label(process, process.node(owner.node))}"
        return f"{numbered(owner.log.name, owner.log.number)} of {owner.log.label}"


def _is_direct(thread: ObservedThread) -> bool:
    """Whether the callback that a thread has just begun belongs to the message or timer that it took or called
    before."""
    return bool(thread.callbacks) and thread.callbacks[-1].is_direct


def _end_ns(turn: OpenTurn, hit: Hit, thread: ObservedThread) -> int | None:
    """When a turn ended, given the next action of its thread; None if the end was not seen."""
    if turn.has_callback:
        return None
    if turn.triggers > 1:
        return turn.triggered_ns
    return hit.at_ns if thread.triggers is None and thread.has_waited else None
