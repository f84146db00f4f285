"""Timers and callbacks: what the hits of their calls show."""

from collections.abc import Callable

from rtrun.flows.messages import SUBSCRIPTIONS, Endpoint, Reception
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import LivingThing, numbered
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.threads import CALLBACKS, CallbackLog, LivingCallback, ObservedThread, OpenCallback
from rtrun.flows.timers import LEAST_CALLS, TIMERS, LivingTimer, TimerLog
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.probes.hits import Hit

_NESTED_MAX = 64  # callbacks within one another: with more, exceptions left them, and they never end


class CallRecord:
    """The timers and callbacks of an observation."""

    def __init__(self, state: ObservationState, recorder: FlowRecorder | None) -> None:
        self.timers: dict[tuple[str, int | None, str | None, int], TimerLog] = {}
        """By label, period, clock, and number among timers with the same three."""
        self.callbacks: dict[tuple[str, str, int, int], CallbackLog] = {}
        """By label, subject, number among callbacks with the same two, and number of the thread."""
        self.handlers: dict[str, Callable[[Hit, ObservedThread], None]] = {
            "callback_begin": self._begin,
            "callback_end": self._end,
            "subscription_linked": self._link_subscription,
            "callback_added": self._add_callback,
            "timer_callback_added": self._add_callback,
            "timer_init": self._init_timer,
            "timer_linked": self._link_timer,
            "timer_call": self._call_timer,
        }
        self._state = state
        self._recorder = recorder

    # Timers.

    def _init_timer(self, hit: Hit, thread: ObservedThread) -> None:
        thread.does_other_work()
        self._made(hit, thread)

    def _made(self, hit: Hit, thread: ObservedThread) -> LivingTimer | None:
        handle, period_ns, clock = (hit.values.get(key) for key in ("timer", "period_ns", "clock"))
        if handle is None:
            self._state.unreadable += 1
            return None
        timers = TIMERS.of(thread.process)
        if not self._state.has_room(handle, timers):
            return None
        if handle in timers:
            timers[handle].is_replaced = True
        period_ns = period_ns if isinstance(period_ns, int) else None
        clock = clock if isinstance(clock, str) else None
        timer = timers[handle] = LivingTimer(thread.process, handle, period_ns, clock)
        return timer

    def _link_timer(self, hit: Hit, thread: ObservedThread) -> None:
        thread.does_other_work()
        timer = TIMERS.of(thread.process).get(hit.values.get("timer", ""))
        if timer is None:
            self._state.unreadable += 1
        else:
            timer.node = hit.values.get("node")

    def _call_timer(self, hit: Hit, thread: ObservedThread) -> None:
        values = hit.values
        timer = TIMERS.of(thread.process).get(values.get("timer", ""))
        period_ns = values.get("period_ns")
        if timer is None or (period_ns is not None and timer.period_ns not in (None, period_ns)):
            # A timer with a new period counts as another timer from then on.
            timer = self._made(hit, thread)
            if timer is None:
                thread.does_other_work()
                return
        if timer.log is None:
            timer.period_ns = timer.period_ns if not isinstance(period_ns, int) else period_ns
            clock = values.get("clock")
            timer.clock = clock if isinstance(clock, str) else timer.clock
        thread.calls_timer(timer)
        expected = values.get("expected_ns")
        call = (hit.at_ns, expected if isinstance(expected, int) else NOT_SEEN_NS, self._state.epoch)
        if timer.log is not None:
            timer.log.add(*call[:2], timer, call[2])
            return
        timer.early.append(call)
        if len(timer.early) >= LEAST_CALLS:
            if self._state.is_full:
                timer.early.clear()
                return
            timer.log = self._log_of(timer)
            for at_ns, expected_ns, epoch in timer.early:
                timer.log.add(at_ns, expected_ns, timer, epoch)
            timer.early.clear()

    def _log_of(self, timer: LivingTimer) -> TimerLog:
        name = self._state.label(timer.process, timer.process.node(timer.node))
        alike = (name, timer.period_ns, timer.clock)
        number = self._state.numbering.number(("timer", *alike), timer)
        log = self.timers.get((*alike, number))
        if log is None:
            self._state.add_stream()
            log = self.timers[*alike, number] = TimerLog(*alike, number, self._state.store)
        return log

    # Callbacks.

    def _link_subscription(self, hit: Hit, thread: ObservedThread) -> None:
        """rclcpp made its own object for a subscription of rcl."""
        thread.does_other_work()
        subscriptions, handle = SUBSCRIPTIONS.of(thread.process), hit.values.get("object")
        endpoint = subscriptions.get(hit.values.get("subscription", ""))
        if handle is not None and endpoint is not None and self._state.has_room(handle, subscriptions):
            subscriptions[handle] = endpoint

    def _add_callback(self, hit: Hit, thread: ObservedThread) -> None:
        """A timer or subscription gets a callback."""
        thread.does_other_work()
        handle = hit.values.get("callback")
        if handle is None:
            self._state.unreadable += 1
            return
        process = thread.process
        callbacks = CALLBACKS.of(process)
        if not self._state.has_room(handle, callbacks):
            return
        if handle in callbacks:
            callbacks[handle].is_replaced = True
        made = callbacks[handle] = LivingCallback(process)
        timer = TIMERS.of(process).get(hit.values.get("timer", ""))
        made.owner = timer or SUBSCRIPTIONS.of(process).get(hit.values.get("object", ""))

    def _begin(self, hit: Hit, thread: ObservedThread) -> None:
        thread.has_callbacks = True
        cause, thread.cause = thread.cause, None
        handle = hit.values.get("callback")
        if handle is None:
            self._state.unreadable += 1
            return
        callback = CALLBACKS.of(thread.process).get(handle)
        if callback is None:
            if not self._state.add_thing():
                return
            callback = CALLBACKS.of(thread.process)[handle] = LivingCallback(thread.process)
        # roscpp tells the topic: another thread took the message.
        is_told = "topic" in hit.values
        message = cause if not is_told and callback.is_of(cause) and isinstance(cause, Reception) else None
        if len(thread.callbacks) >= _NESTED_MAX:
            thread.callbacks.clear()
        thread.callbacks.append(OpenCallback(callback, hit.at_ns, message))

    def _end(self, hit: Hit, thread: ObservedThread) -> None:
        thread.cause = None
        handle = hit.values.get("callback")
        opened = None
        # The callbacks above it ended by an exception.
        while thread.callbacks and opened is None:
            opened = thread.callbacks.pop()
            if handle is not None and CALLBACKS.of(thread.process).get(handle) is not opened.callback:
                opened = None
        if opened is None:
            return
        if opened.message is not None:
            opened.message.ended(hit.at_ns)
        self._add_call(opened.callback, thread, hit, opened.begin_ns)

    def _add_call(self, callback: LivingCallback, thread: ObservedThread, end: Hit, begin_ns: int) -> None:
        callback.calls += 1
        log = callback.logs.get(thread)
        if log is not None:
            log.rows.add((begin_ns, end.at_ns))
        else:
            callback.early.append((thread, begin_ns, end.at_ns))
            if self._state.is_full:
                callback.early.clear()
            elif callback.is_ready:
                self._name(callback)
        if self._recorder is not None:
            name = callback.named[1] if callback.named else "callback"
            self._recorder.callback(name, thread.process.pid, thread.tid, end.cpu, begin_ns, end.at_ns)

    def _name(self, callback: LivingCallback) -> None:
        numbering = self._state.numbering
        if callback.named is None:
            process = callback.process
            callback.named = _named(self._state.label(process, process.label), callback.owner)
            callback.number = numbering.number(("callback", *callback.named), callback)
        for thread, begin_ns, end_ns in callback.early:
            log = callback.logs.get(thread)
            if log is None:
                alike = (*callback.named, callback.number)
                number = numbering.number(("thread", *alike), thread)
                log = self.callbacks.get((*alike, number))
                if log is None:
                    self._state.add_stream()
                    log = self.callbacks[*alike, number] = CallbackLog(*alike, number, self._state.store)
                callback.logs[thread] = log
            log.rows.add((begin_ns, end_ns))
        callback.early.clear()


def _named(label: str, owner: LivingThing | None) -> tuple[str, str]:
    """The label of a callback's node (of its process, if its owner is not known), and its topic or timer."""
    if isinstance(owner, LivingTimer) and owner.log is not None:
        return owner.log.label, numbered(owner.log.name, owner.log.number)
    if isinstance(owner, Endpoint):
        return owner.end.label, owner.topic
    return label, ""
