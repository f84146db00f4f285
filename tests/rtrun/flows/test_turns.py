"""What a thread had to do before something else: when a callback ended is known, or said not to be."""

import pytest
from made_flows import hit, node, publish, take, take_bytes

from rtrun.flows.accumulator import FlowAccumulator

WAIT, TRIGGER = "wait", "guard_trigger"


def timer(at_ns):
    return hit(at_ns, "timer_call", pid=2, timer=7, period_ns=10**6)


def seen(at_ns, event, **values):
    return hit(at_ns, event, pid=2, **values)


MESSAGE = "/a of /listener"
TIMER = "timer 1 ms of /listener"
CASES = {
    # The guard is triggered when the message was taken, in the callback, and at its end.
    "rclpy": (
        [seen(100, WAIT), take(110, 1), *(seen(at, TRIGGER) for at in (120, 140, 150)), seen(170, WAIT)],
        [(110, 150, MESSAGE)],
    ),
    "rclpy of which the end is missing": ([take(110, 1), seen(120, TRIGGER), take(300, 2)], [(110, None, MESSAGE)]),
    "a program in C": (
        [seen(100, WAIT), timer(110), take(130, 1), seen(170, WAIT)], [(110, 130, TIMER), (130, 170, MESSAGE)]
    ),
    # What it did between the two is not known.
    "a program in C that asks for messages now and then": ([take(110, 1), take(900, 2)], [(110, None, MESSAGE)]),
    "rclcpp": (
        [seen(100, WAIT), take(110, 1), seen(111, "callback_begin", callback=5), seen(140, "callback_end", callback=5),
         seen(160, "callback_begin", callback=6), seen(170, "callback_end", callback=6), seen(190, WAIT)],
        [(110, 140, MESSAGE), (160, 170, "a callback of /listener")],
    ),
    "a copy that rclcpp discards": (
        [seen(90, "callback_begin", callback=5), seen(95, "callback_end", callback=5), take(110, 1),
         seen(120, "callback_begin", callback=6, intra_process=1), seen(130, "callback_end", callback=6), take(140, 2),
         seen(150, WAIT)],
        [(90, 95, "a callback of /listener"), (120, 130, "a callback of /listener")],
    ),
    # Thread 9 calls the timer, and another one its callback.
    "EventsExecutor": (
        [seen(90, "callback_begin", callback=5), seen(95, "callback_end", callback=5),
         *(timer(at)._replace(tid=9) for at in (100, 200)),
         seen(210, "timer_execute", timer=7, expected_ns=100), seen(211, "callback_begin", callback=6),
         seen(220, "callback_end", callback=6), timer(300)._replace(tid=9)],
        [(90, 95, "a callback of /listener"), (211, 220, TIMER)],
    ),
    "roscpp": (
        [seen(110, "callback_begin", callback=5, topic="/a"), timer(150)], [(110, None, "/a of /listener")]
    ),
    "a message that another thread calls back for": ([take_bytes(110, (1, 2, 30)), seen(150, WAIT)], []),
    "nothing was taken": ([seen(100, WAIT), take(110, 1, taken=0), seen(120, WAIT)], []),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_turns_of_a_thread(case):
    hits, expected = case
    turns = []
    observed = FlowAccumulator(begin_ns=0, on_turn=turns.append)
    observed.observe([node(2, "listener")])
    observed.feed([publish(1), publish(2), *hits])
    assert [(turn.begin_ns, turn.end_ns, turn.name) for turn in turns] == expected
    assert {turn.pid for turn in turns} <= {2}


def test_a_timer_of_a_second_program_of_one_name_has_one_name_from_its_first_call_on():
    turns = []
    observed = FlowAccumulator(begin_ns=0, on_turn=turns.append)
    observed.observe([node(1, "twin"), node(2, "twin")])
    observed.feed(
        [
            publish(1, topic="/twin"),
            *(seen_hit for at in range(10, 60, 10) for seen_hit in (timer(at * 10**5), seen(at * 10**5 + 9, WAIT))),
        ]
    )
    assert len({turn.name for turn in turns}) == 1 and len(turns) == 5
