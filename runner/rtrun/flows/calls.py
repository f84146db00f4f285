"""Timers and callbacks, from the hits of their calls."""

from collections.abc import Callable

from rtrun.flows.messages import SUBSCRIPTIONS, Endpoint, Reception
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import LivingProcess, LivingThing, numbered
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.threads import CALLBACKS, CallbackLog, Cause, LivingCallback, ObservedThread, OpenCallback, owner_of
from rtrun.flows.timers import LEAST_CALLS, TIMERS, LivingTimer, TimerCall, TimerLog
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.probes.hits import Hit

_NESTED_MAX = 64  #: callbacks of a thread within one another; with more, exceptions left them


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
            "timer_execute": self._execute_timer,
        }
        self._state = state
        self._recorder = recorder

    # Timers.

    def _init_timer(self, hit: Hit, thread: ObservedThread) -> None:
        thread.does_other_work()
        if (timer := self._made(hit, thread)) is not None:
            timer.whole_epoch = self._state.epoch

    def _made(self, hit: Hit, thread: ObservedThread) -> LivingTimer | None:
        handle, period_ns, clock = (hit.values.get(key) for key in ("timer", "period_ns", "clock"))
        if handle is None:
            self._state.unreadable += 1
            return None
        timers = TIMERS.table_of(thread.process)
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
        self._shows_callbacks(thread.process)
        timer = TIMERS.table_of(thread.process).get(hit.values.get("timer", ""))
        if timer is None:
            self._state.unreadable += 1
        else:
            timer.node = hit.values.get("node")

    def _call_timer(self, hit: Hit, thread: ObservedThread) -> None:
        values = hit.values
        timer = TIMERS.table_of(thread.process).get(values.get("timer", ""))
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
        expected = values.get("expected_ns")
        timer.due_ns = expected if isinstance(expected, int) else timer.due_ns
        call = TimerCall(timer, hit.at_ns, expected if isinstance(expected, int) else NOT_SEEN_NS)
        thread.calls_timer(call)
        (timer.log or timer).calls += 1
        if "is_begin" in values or not thread.process.shows_callbacks:
            self._add_row(timer, call.at_ns, call.expected_ns)
        else:
            timer.waits(call)
        if timer.log is None and timer.calls >= LEAST_CALLS:
            if not self._state.is_full:
                timer.log = self._log_of(timer)
                timer.log.calls += timer.calls
                timer.log.unpaired += timer.unpaired
                for begin_ns, due_ns, epoch in timer.early:
                    timer.log.add(begin_ns, due_ns, timer, epoch)
            timer.early.clear()

    def _execute_timer(self, hit: Hit, thread: ObservedThread) -> None:
        """An executor takes a call of a timer from its queue; the callback begins next on this thread."""
        self._shows_callbacks(thread.process)
        timer = TIMERS.table_of(thread.process).get(hit.values.get("timer", ""))
        if timer is None:
            thread.does_other_work()
            return
        # Each callback shows its call, so their order is not needed.
        timer.waiting.clear()
        timer.whole_epoch = None
        call = TimerCall(timer, hit.at_ns, timer.checked_due(hit.values.get("expected_ns")))
        thread.calls_timer(call)
        if call.expected_ns == NOT_SEEN_NS and timer.due_ns is not None:
            (timer.log or timer).unpaired += 1

    def _begin_timer(self, timer: LivingTimer, cause: Cause | None, begin_ns: int) -> None:
        """The callback of a timer begins: directly after its call on the same thread, or taken from a queue."""
        if isinstance(cause, TimerCall) and cause.timer is timer:
            while timer.waiting and timer.waiting[0].at_ns <= cause.at_ns:
                timer.waiting.popleft()
            call: TimerCall | None = cause
        else:
            call = timer.next_waiting(self._state.epoch)
            (timer.log or timer).unpaired += call is None
        self._add_row(timer, begin_ns, NOT_SEEN_NS if call is None else call.expected_ns)

    def _add_row(self, timer: LivingTimer, begin_ns: int, expected_ns: int) -> None:
        if timer.log is not None:
            timer.log.add(begin_ns, expected_ns, timer, self._state.epoch)
        elif len(timer.early) < LEAST_CALLS:
            timer.early.append((begin_ns, expected_ns, self._state.epoch))

    def _shows_callbacks(self, process: LivingProcess) -> None:
        """Note that a process is of rclcpp. If that was not known, calls of its timers were taken for begins: forget
        these."""
        if process.shows_callbacks:
            return
        process.has_shown_callbacks = True
        for timer in TIMERS.table_of(process).values():
            timer.early.clear()
            if (log := timer.log) is not None:
                timer.log = TimerLog(log.label, log.period_ns, log.clock, log.number, self._state.store)
                timer.log.calls = log.calls
                self.timers[log.label, log.period_ns, log.clock, log.number] = timer.log

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
        self._shows_callbacks(thread.process)
        subscriptions, handle = SUBSCRIPTIONS.table_of(thread.process), hit.values.get("object")
        endpoint = subscriptions.get(hit.values.get("subscription", ""))
        if handle is not None and endpoint is not None and self._state.has_room(handle, subscriptions):
            subscriptions[handle] = endpoint

    def _add_callback(self, hit: Hit, thread: ObservedThread) -> None:
        """A timer or subscription gets a callback."""
        thread.does_other_work()
        self._shows_callbacks(thread.process)
        handle = hit.values.get("callback")
        if handle is None:
            self._state.unreadable += 1
            return
        process = thread.process
        callbacks = CALLBACKS.table_of(process)
        if not self._state.has_room(handle, callbacks):
            return
        if handle in callbacks:
            callbacks[handle].is_replaced = True
        callback = callbacks[handle] = LivingCallback(process)
        timer = TIMERS.table_of(process).get(hit.values.get("timer", ""))
        callback.owner = timer or SUBSCRIPTIONS.table_of(process).get(hit.values.get("object", ""))
        callback.is_linked = callback.owner is not None

    def _begin(self, hit: Hit, thread: ObservedThread) -> None:
        thread.has_callbacks = True
        cause, thread.cause = thread.cause, None
        handle = hit.values.get("callback")
        if handle is None:
            self._state.unreadable += 1
            return
        callback = CALLBACKS.table_of(thread.process).get(handle)
        if callback is None:
            if not self._state.add_thing():
                return
            callback = CALLBACKS.table_of(thread.process)[handle] = LivingCallback(thread.process)
        is_handled = self._is_handled(cause, callback, hit)
        if isinstance(callback.owner, LivingTimer):
            if not callback.is_mixed:
                self._begin_timer(callback.owner, cause, hit.at_ns)
            elif callback.owner.log is not None:
                callback.owner.log.is_mixed = True
        if len(thread.callbacks) >= _NESTED_MAX:
            thread.callbacks.clear()
        message = cause if is_handled and isinstance(cause, Reception) else None
        is_direct = not callback.is_mixed and callback.owner is not None and callback.owner is owner_of(cause)
        is_direct = is_direct and hit.values.get("intra_process") != 1
        thread.callbacks.append(OpenCallback(callback, hit.at_ns, message, is_direct))

    def _is_handled(self, cause: Cause | None, callback: LivingCallback, begin: Hit) -> bool:
        """Whether a callback that begins handles the message or timer that its thread took or called directly
        before."""
        # roscpp tells the topic: another thread took the message.
        if "topic" in begin.values:
            return False
        process = callback.process
        self._shows_callbacks(process)
        is_by_pointer = begin.values.get("intra_process") == 1
        if is_by_pointer and not process.passes_pointers:
            process.passes_pointers = True
            for living in CALLBACKS.table_of(process).values():
                living.forget_guess()
        is_handled = not is_by_pointer and callback.is_of(cause)
        # Of unknown callbacks, any may be another's.
        is_others = process.passes_pointers or callback.owner not in (None, owner_of(cause))
        if isinstance(cause, Reception) and is_others and not is_handled:
            cause.is_left()
        return is_handled

    def _end(self, hit: Hit, thread: ObservedThread) -> None:
        thread.turns_to(None)
        handle = hit.values.get("callback")
        opened = None
        # The callbacks above it ended by an exception.
        while thread.callbacks and opened is None:
            opened = thread.callbacks.pop()
            if handle is not None and CALLBACKS.table_of(thread.process).get(handle) is not opened.callback:
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
    """The label of a callback's node (if its owner is not known, of its process), and its topic or timer."""
    if isinstance(owner, LivingTimer) and owner.log is not None:
        return owner.log.label, numbered(owner.log.name, owner.log.number)
    if isinstance(owner, Endpoint):
        return owner.end.label, owner.topic
    return label, ""
