"""Where a message spent its time: the parts of its latency by the steps between two programs.

A publisher hands a message to a thread that writes it into the transport. A thread of the subscriber reads it and
queues it for the thread that calls back. This is how roscpp works (`TopicManager::publish`, `PollManager`,
`Subscription::handleMessage`, `CallbackQueue`). In a middleware without one of these threads, its step takes no time.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum

from rtrun.causes.parts import Kind, Part
from rtrun.causes.timeline import State


class Step(StrEnum):
    """The steps in their order; a thread that waits for a CPU has begun its step."""

    PUBLISHER = "publisher"
    WRITE = "publisher's thread writes"
    TRANSPORT = "transport"
    READ = "subscriber's thread reads"
    QUEUE = "queue"
    CALLBACK = "callback"
    UNKNOWN = "unexplained"


def steps(parts: Sequence[Part], *, pid: int | None, own: frozenset[int]) -> Mapping[Step, int]:
    """The nanoseconds of each step, in order; they add up to the parts.

    `pid` is the thread of the callback; None: the latency ends when the subscriber has read the message. `own` are the
    threads of the subscriber. The last of the other threads is the one that wrote.
    """
    writer = next((part.pid for part in reversed(parts) if part.pid is not None and part.pid not in own), None)
    lengths: Counter[Step] = Counter()
    for part in parts:
        lengths[_step(part, pid, own, writer)] += part.length_ns
    return {step: lengths[step] for step in Step if lengths[step]}


def _step(part: Part, pid: int | None, own: frozenset[int], writer: int | None) -> Step:
    if part.pid is None:
        return Step.UNKNOWN if part.cause.kind is Kind.UNEXPLAINED else Step.TRANSPORT
    if part.pid == pid:
        return Step.CALLBACK if part.state is State.RUNNING else Step.QUEUE
    if part.pid in own:
        return Step.READ
    return Step.WRITE if part.pid == writer else Step.PUBLISHER
