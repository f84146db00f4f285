#!/usr/bin/env python3
"""An observation of so many messages, calls and callbacks 100 us apart, as its rows have it; its runs are written.

hour.py MESSAGES FOLDER
"""

import sys
from pathlib import Path

import numpy as np

TOP = Path(__file__).parents[2]
sys.path[:0] = [str(TOP / folder) for folder in ("runner", "tools")]
sys.path += [str(TOP / "tests/rtrun")]
from made_flows import hit  # noqa: E402
from written import stream_facts  # noqa: E402

from rtrun.execution.stream_runs import write_streams  # noqa: E402
from rtrun.flows.accumulator import FlowAccumulator  # noqa: E402
from rtrun.flows.rows import RowStore  # noqa: E402
from rtrun.flows.streams import streams  # noqa: E402

PERIOD_NS = 100_000
AT_ONCE = 50_000


def cycle(at_ns):
    """The hits of one message, of the callback that it is given to, and of a timer."""
    return [
        hit(at_ns, "publish", endpoint=5, topic="/a", source_ns=at_ns),
        hit(at_ns + 50, "take", pid=2, endpoint=6, topic="/a", source_ns=at_ns),
        hit(at_ns + 60, "callback_begin", pid=2, callback=9),
        hit(at_ns + 70, "callback_end", pid=2, callback=9),
        hit(at_ns + 80, "timer_call", timer=3, period_ns=PERIOD_NS, expected_ns=at_ns, clock="steady"),
    ]


def main() -> None:
    """Feed the first ones as hits, and add the others as what comes of these."""
    count, folder = int(sys.argv[1]), Path(sys.argv[2])
    observed = FlowAccumulator(begin_ns=0, store=RowStore(folder))
    first = 20
    for number in range(1, first):
        observed.feed(cycle(number * PERIOD_NS))
    (pair,), (timer,) = observed.topics.pairs.values(), observed.calls.timers.values()
    (callback,), link = observed.calls.callbacks.values(), pair.link
    for begin in range(first, count, AT_ONCE):
        at = np.arange(begin, min(begin + AT_ONCE, count)) * PERIOD_NS
        pair.publisher.times.add(at.tolist())
        pair.subscriber.times.add((at + 50).tolist())
        pair.subscriber.received += at.size
        pair.rows.add(np.stack([at, at + 50, at + 70, at // PERIOD_NS - 1], axis=1).ravel().tolist())
        callback.rows.add(np.stack([at + 60, at + 70], axis=1).ravel().tolist())
        timer.rows.add(np.stack([at + 80, at], axis=1).ravel().tolist())
        link.last, link.until_ns = len(pair.rows) - 1, int(at[-1]) + 50
        observed.newest_ns = int(at[-1]) + 90
        observed.state.store.ease()
    observed.finish()
    facts = stream_facts(folder / "facts")
    (folder / "results").mkdir()
    written = write_streams(folder / "results/001", facts, streams(observed), {})
    assert not any((written.left_out, written.not_kept, written.unseen)), written


main()
