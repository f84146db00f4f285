"""What a thread is doing: the message or timer that it handles, and its open callbacks."""

from dataclasses import dataclass
from typing import NamedTuple

from rtrun.flows.messages import Publication, Reception
from rtrun.flows.programs import HandleTable, LivingProcess, LivingThing
from rtrun.flows.requests import Request, Server
from rtrun.flows.rows import RowStore
from rtrun.flows.timers import LivingTimer, TimerCall

Cause = Reception | TimerCall
_CALLS_WITHOUT_CAUSE = 8


def owner_of(cause: Cause | None) -> LivingThing | None:
    """The subscription of a message that a thread took, or the timer that it called."""
    return cause.timer if isinstance(cause, TimerCall) else cause.endpoint if cause is not None else None


class CallbackLog:
    """The calls of a callback on one thread, over all restarts of its program. `rows`: begin and end."""

    __slots__ = ("label", "number", "rows", "subject", "thread")

    def __init__(self, label: str, subject: str, number: int, thread: int, store: RowStore) -> None:
        self.label = label
        self.subject = subject
        self.number = number
        self.thread = thread
        self.rows = store.rows(2)


class LivingCallback(LivingThing):
    """A callback of a living process. It gets a subject once its owner is known, or certain to stay unknown.

    `owner` is the subscription or timer whose callback it is. `is_linked`: rclcpp has named the owner; otherwise the
    first call shows it. `is_guess`: only messages that may be copies have shown it. `is_mixed`: it was called after
    several owners, so it is not known what it handles.
    """

    __slots__ = ("calls", "early", "is_guess", "is_linked", "is_mixed", "logs", "named", "number", "owner")

    def __init__(self, process: LivingProcess) -> None:
        super().__init__(process)
        self.owner: LivingThing | None = None
        self.is_guess = self.is_linked = self.is_mixed = False
        self.named: tuple[str, str] | None = None
        """The label of its node, and its topic or timer."""
        self.number = 0
        self.calls = 0
        self.early: list[tuple[ObservedThread, int, int]] = []
        self.logs: dict[ObservedThread, CallbackLog] = {}

    def is_of(self, cause: Cause | None) -> bool:
        """Whether a call directly after `cause` handles it. The first cause shows whose callback it is."""
        if cause is None:
            return False
        owner = owner_of(cause)
        if self.is_linked:
            return self.owner is owner
        is_guess = isinstance(cause, Reception) and cause.is_own
        if is_guess and self.process.passes_pointers and self.owner is not owner:
            return False
        if self.owner is None:
            self.owner, self.is_guess = owner, is_guess
        elif self.owner is not owner:
            self.is_mixed = True
        self.is_guess &= is_guess
        return not self.is_mixed and self.is_certain

    @property
    def is_certain(self) -> bool:
        """Whether its owner is certain: several calls have not shown that its process passes messages by pointer."""
        return not self.is_guess or self.calls >= _CALLS_WITHOUT_CAUSE

    def forget_guess(self) -> None:
        """Its process passes messages by pointer: what it took before a call does not show the owner."""
        if self.is_guess:
            self.owner, self.is_guess, self.is_mixed = None, False, False

    @property
    def is_ready(self) -> bool:
        """Whether it can be named: its subject is known, or several calls have not revealed it."""
        known = self.owner is not None and (not isinstance(self.owner, LivingTimer) or self.owner.log is not None)
        return (known and self.is_certain) or self.calls >= _CALLS_WITHOUT_CAUSE


CALLBACKS = HandleTable[LivingCallback]()


class OpenCallback(NamedTuple):
    """A callback that has begun. `message` is the one that it handles, if that is certain.

    `is_direct`: as far as is known, it belongs to the message or timer that its thread took or called directly before.
    """

    callback: LivingCallback
    begin_ns: int
    message: Reception | None
    is_direct: bool


@dataclass(slots=True)
class OpenTurn:
    """A piece of work that a thread has begun: how often it has triggered a guard condition since, and when last.

    `awaits_callback`: it has taken or called something, and the callback may begin elsewhere, or never.
    """

    begin_ns: int
    cpu: int
    name: str
    has_callback: bool
    awaits_callback: bool
    triggers: int = 0
    triggered_ns: int = 0


class ObservedThread:
    """A thread of a living process, between two gaps.

    `cause` is the message or timer that it last took or called, until it does something else. A message that it
    publishes belongs to the message in whose callback it does so (`handled`):

    - if callbacks are seen: between begin and end of a callback that began directly after its message was taken;
    - in rclpy, which triggers a guard condition before and after each callback: between the two;
    - otherwise, if the thread is seen to wait: after the only message that it took since then.
    """

    __slots__ = (
        "callbacks", "cause", "has_callbacks", "has_ended", "has_waited", "process", "published", "request", "taken",
        "tid", "took", "triggers", "turn",
    )  # fmt: skip

    def __init__(self, tid: int, process: LivingProcess) -> None:
        self.tid = tid
        self.process = process
        self.has_ended = False
        self.cut()

    @property
    def is_alive(self) -> bool:
        return self.process.is_alive and not self.has_ended

    def cut(self) -> None:
        """Hits are missing: what it does now is unknown."""
        self.cause: Cause | None = None
        self.callbacks: list[OpenCallback] = []
        self.has_callbacks = False
        self.has_waited = False
        self.turn: OpenTurn | None = None
        self.published: Publication | None = None
        """The publication that was its last hit, if that does not show its time stamp."""
        self.request: Request | None = None
        """What it has sent, until the number of that is seen."""
        self.took: tuple[Server, int] | None = None
        """The server for which it has looked for a request since it took anything else, and when."""
        self.triggers: int | None = None
        """Since the last message was taken; None: it was never seen to trigger, so it may not be rclpy."""
        self.taken: int | None = None
        """Messages since it last waited; None: it was never seen to wait, or has done something else since."""

    def turns_to(self, cause: Cause | None) -> None:
        """It does something else: there was no callback for what it took before."""
        if isinstance(self.cause, Reception):
            self.cause.is_left()
        self.cause = cause

    def takes(self, reception: Reception) -> None:
        self.turns_to(reception)
        self.took = None
        if self.taken is not None:
            self.taken += 1
        if self.triggers is not None:
            self.triggers = 0

    def calls_timer(self, call: TimerCall) -> None:
        self.turns_to(call)
        self.took = None
        self.taken = None

    def waits(self) -> None:
        self.has_waited = True
        self.turns_to(None)
        self.took = None
        self.taken = 0

    def triggers_guard(self) -> None:
        self.triggers = 1 if self.triggers is None else self.triggers + 1

    def does_other_work(self) -> None:
        """The thread does something that is neither a publication nor anything above."""
        self.turns_to(None)
        self.taken = None

    @property
    def handled(self) -> Reception | None:
        """The message in whose callback the thread is now; None if that is not certain."""
        if self.callbacks:
            return self.callbacks[-1].message
        cause = self.cause
        if self.has_callbacks or self.process.shows_callbacks or not isinstance(cause, Reception):
            return None
        if self.triggers is not None:
            return cause if self.triggers == 1 else None
        return cause if self.taken == 1 else None
