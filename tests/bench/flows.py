"""What it costs to read 20 000 messages a second from the hits of probes, 40 000 hits, and to show them each second.

`make bench` runs it; it is no test. CPU time of this process is counted, the least of several seconds.
"""

import time
from collections.abc import Callable

import pytest
from made_flows import S, publish, publish_bytes, take, take_bytes

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.probes.hits import Hit

MESSAGES_PER_S, TOPICS, SECONDS = 20_000, 10, 14
LATENCY_NS = 30_000
HIT_MAX_US = 10.0


def stamped(at_ns: int, topic: str, endpoint: int) -> list[Hit]:
    return [publish(at_ns, topic, endpoint=endpoint), take(at_ns + LATENCY_NS, at_ns, topic, endpoint=endpoint)]


def by_bytes(at_ns: int, topic: str, endpoint: int) -> list[Hit]:
    payload = (at_ns, 7, 30)
    sent = publish_bytes(at_ns, payload, topic, endpoint=endpoint)
    return [sent, take_bytes(at_ns + LATENCY_NS, payload, topic, endpoint=endpoint)]


@pytest.mark.parametrize("message", [stamped, by_bytes])
def test_twenty_thousand_messages_a_second(message: Callable[[int, str, int], list[Hit]]) -> None:
    observed = FlowAccumulator(begin_ns=0, paths=[("/topic1", "/topic2")])
    live = LiveFigures(observed)
    hit_us, snapshot_ms = [], []
    for second in range(SECONDS):
        starts = range(second * S, (second + 1) * S, S // MESSAGES_PER_S)
        hits = [
            hit for number, at in enumerate(starts) for hit in message(at, f"/topic{number % TOPICS}", number % TOPICS)
        ]
        began = time.process_time()
        observed.feed(hits)
        fed = time.process_time()
        rows = live.snapshot((second + 1) * S).rows
        hit_us.append((fed - began) / len(hits) * 1e6)
        snapshot_ms.append((time.process_time() - fed) * 1e3)
    received = sum(row.n for row in rows if row.kind is MESSAGES)
    assert received == SECONDS * MESSAGES_PER_S, [(row.kind, row.name, row.n) for row in rows]
    # In the last seconds publications are forgotten, too.
    least_us = min(hit_us[-3:])
    print(f"\n{message.__name__}: {least_us:.1f} us a hit, {min(snapshot_ms[-3:]):.1f} ms a snapshot")
    assert least_us < HIT_MAX_US
