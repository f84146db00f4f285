"""Which tolerance lets through what, against every sequence of a few loops."""

import itertools

from rtrun.plan.question import Tolerance

LOOPS = 8


def allowed(tolerance):
    """All sequences of LOOPS loops, 1 a miss, of which no window holds more misses than it may."""
    return {
        sequence
        for sequence in itertools.product((0, 1), repeat=LOOPS)
        if all(
            sum(sequence[at : at + tolerance.among]) <= tolerance.misses for at in range(LOOPS - tolerance.among + 1)
        )
    }


def test_one_is_within_another_where_it_allows_nothing_more():
    every = [Tolerance(misses=misses, among=among) for among in range(1, 5) for misses in range(among)]
    sequences = {tolerance: allowed(tolerance) for tolerance in every}
    for first, second in itertools.product(every, repeat=2):
        assert first.is_within(second) == (sequences[first] <= sequences[second]), (first, second)
