"""What a sampler prints that is none of ours: refused within its limits."""

import pytest

from rtfiles.errors import UsageError
from rtrun.validity.observations import STATE_LINES_MAX, read_observations

AT = "at 10.00 0.50 - - cpu 1 2 3 4 5 6 7 8 0 0\n"
THREAD = "thread x 12 1 95 0-1 x\n"


def test_a_state_of_more_lines_than_a_target_has_threads_is_refused():
    (observation,) = read_observations(AT + STATE_LINES_MAX * THREAD + "end\n")
    assert observation.threads == {"x": STATE_LINES_MAX * (("FIFO", 95, frozenset({0, 1})),)}
    with pytest.raises(UsageError, match=r"sampler.stdout:50002: not what sample.sh writes: 'thread x"):
        read_observations(AT + (STATE_LINES_MAX + 1) * THREAD + "end\n")
