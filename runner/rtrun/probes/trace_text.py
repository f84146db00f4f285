"""Decoded events of the kernel as text, in the form in which the kernel prints them (Documentation/trace/ftrace.rst).

Every trace is kept in this form. Times have nanoseconds here. Kernel addresses are hashed, as in the kernel's own text;
functions with a name in `symbols` are printed by that name.
"""

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from hashlib import blake2b
from os import urandom

from rtrun.probes.hits import Gap, Hit

Values = Mapping[str, int | str]

# trace_events.h of the kernel, enum trace_flag_type.
_IRQS_OFF, _LAZY, _RESCHED, _HARD, _SOFT, _PREEMPT_RESCHED, _NMI, _BH_OFF = (1 << bit for bit in range(8))
_RESCHED_LETTERS = {
    _RESCHED | _LAZY | _PREEMPT_RESCHED: "B",
    _RESCHED | _PREEMPT_RESCHED: "N",
    _LAZY | _PREEMPT_RESCHED: "L",
    _RESCHED | _LAZY: "b",
    _RESCHED: "n",
    _LAZY: "l",
    _PREEMPT_RESCHED: "p",
}
# sched.h of the kernel, TASK_REPORT; the bit after the last of them: preempted.
_STATES = "SDTtXZPI"
# interrupt.h of the kernel.
_SOFTIRQS = ("HI", "TIMER", "NET_TX", "NET_RX", "BLOCK", "IRQ_POLL", "TASKLET", "SCHED", "HRTIMER", "RCU")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_SECRET = urandom(16)
_NAMES_MAX = 20_000  #: names of threads in a trace of an observation
_SYSTEM_CALL = re.compile(r"sys_(enter|exit)_(\w+)", re.ASCII)


def trace_text(events: Iterable[Hit], gaps: Iterable[Gap], symbols: Mapping[int, str]) -> Iterator[str]:
    """Yield a line for each event, in order, with its line feed. The events are iterated twice.

    Before the first event of each CPU after a gap comes the kernel's line for lost events. Events of a target that do
    not fit their format are left out.
    """
    names = _names(events)
    ends = sorted(gap.until_ns for gap in gaps)
    passed: dict[int, int] = {}
    for at_ns, cpu, _, tid, event, values in events:
        place = passed.get(cpu, 0)
        if place < len(ends) and ends[place] <= at_ns:
            yield f"CPU:{cpu} [LOST EVENTS]\n"
            while place < len(ends) and ends[place] <= at_ns:
                place += 1
            passed[cpu] = place
        try:
            flags = _flags(values["common_flags"], values["common_preempt_count"])
            text = _CONTROL.sub("?", _event(event.rpartition("/")[2], values, symbols))
        except (KeyError, ValueError):
            continue
        seconds, rest_ns = divmod(at_ns, 1_000_000_000)
        yield f"{names.get(tid, '<...>'):>16}-{tid:<7} [{cpu:03}] {flags} {seconds:5}.{rest_ns:09}: {text}\n"


def _names(events: Iterable[Hit]) -> dict[int, str]:
    """The names of threads, taken from their switches."""
    names: dict[int, str] = {}
    for hit in events:
        if hit.event == "sched/sched_switch" and len(names) < _NAMES_MAX:
            with contextlib.suppress(KeyError, ValueError):
                for side in ("prev", "next"):
                    names[int(hit.values[f"{side}_pid"])] = _CONTROL.sub("?", str(hit.values[f"{side}_comm"]))
    return names | {0: "<idle>"}


@lru_cache(maxsize=4096)
def _flags(flags: int | str, preempt_count: int | str) -> str:
    """Interrupts, rescheduling, context, and how deep preemption and migration are disabled: d.h1."""
    assert isinstance(flags, int) and isinstance(preempt_count, int)
    off, both = flags & _IRQS_OFF, flags & _BH_OFF
    irqs = "D" if off and both else "d" if off else "b" if both else "."
    resched = _RESCHED_LETTERS.get(flags & (_RESCHED | _LAZY | _PREEMPT_RESCHED), ".")
    hard, soft = flags & _HARD, flags & _SOFT
    if flags & _NMI:
        context = "Z" if hard else "z"
    else:
        context = "H" if hard and soft else "h" if hard else "s" if soft else "."
    depths = (f"{depth:x}" if depth else "." for depth in (preempt_count & 0xF, preempt_count >> 4 & 0xF))
    return f"{irqs}{resched}{context}{''.join(depths)}"


def _event(name: str, values: Values, symbols: Mapping[int, str]) -> str:
    if match := _SYSTEM_CALL.fullmatch(name):
        if match[1] == "exit":
            return f"sys_{match[2]} -> 0x{_unsigned(values['ret']):x}"
        arguments = (f"{key}: {_unsigned(value):x}" for key, value in _own(values))
        return f"sys_{match[2]}({', '.join(arguments)})"
    printer = _PRINTERS.get(name)
    return f"{name}: {printer(values, symbols) if printer else _plain(_own(values))}"


def _own(values: Values) -> Iterator[tuple[str, int | str]]:
    return ((key, value) for key, value in values.items() if not key.startswith("common_"))


def _plain(values: Iterable[tuple[str, int | str]]) -> str:
    return " ".join(f"{key}={value}" for key, value in values)


def _unsigned(value: int | str) -> int:
    return int(value) & (1 << 64) - 1


@lru_cache(maxsize=4096)
def _hashed(address: int | str) -> str:
    """A name for an address that does not reveal it."""
    return f"{blake2b(_unsigned(address).to_bytes(8), digest_size=4, key=_SECRET).hexdigest():0>16}"


def _switch(values: Values, _: Mapping[int, str]) -> str:
    state = _state(values["prev_state"])
    prev, following = (
        f"{side}_comm={values[f'{side}_comm']} {side}_pid={values[f'{side}_pid']} {side}_prio={values[f'{side}_prio']}"
        for side in ("prev", "next")
    )
    return f"{prev} prev_state={state} ==> {following}"


@lru_cache(maxsize=64)
def _state(state: int | str) -> str:
    number = _unsigned(state)
    letters = "|".join(letter for bit, letter in enumerate(_STATES) if number >> bit & 1) or "R"
    return letters + "+" * (number >> len(_STATES) & 1)


def _wake(values: Values, _: Mapping[int, str]) -> str:
    return _plain((key, f"{value:03}" if key == "target_cpu" else value) for key, value in _own(values))


def _handler_exit(values: Values, _: Mapping[int, str]) -> str:
    return f"irq={values['irq']} ret={'handled' if values['ret'] else 'unhandled'}"


def _softirq(values: Values, _: Mapping[int, str]) -> str:
    vector = int(values["vec"])
    action = _SOFTIRQS[vector] if vector < len(_SOFTIRQS) else hex(vector)
    return f"vec={vector} [action={action}]"


def _timer(values: Values, symbols: Mapping[int, str]) -> str:
    function = symbols.get(_unsigned(values["function"])) or _hashed(values["function"])
    # The function comes second in the text, but last in the event hrtimer_expire_entry.
    first = {"hrtimer": _hashed(values["hrtimer"]), "function": function}
    return _plain((first | {key: value for key, value in _own(values) if key not in first}).items())


def _signal(values: Values, _: Mapping[int, str]) -> str:
    shown = {"group": "grp", "result": "res"}
    return _plain((shown.get(key, key), value) for key, value in _own(values))


def _fault(values: Values, _: Mapping[int, str]) -> str:
    return _plain((key, f"0x{_unsigned(value):x}") for key, value in _own(values))


def _console(values: Values, _: Mapping[int, str]) -> str:
    return str(values.get("msg", ""))


_PRINTERS: dict[str, Callable[[Values, Mapping[int, str]], str]] = {
    "sched_switch": _switch,
    "sched_waking": _wake,
    "sched_wakeup": _wake,
    "sched_wakeup_new": _wake,
    "irq_handler_exit": _handler_exit,
    "softirq_raise": _softirq,
    "softirq_entry": _softirq,
    "softirq_exit": _softirq,
    "hrtimer_start": _timer,
    "hrtimer_expire_entry": _timer,
    "signal_generate": _signal,
    "page_fault_user": _fault,
    "console": _console,
}
