"""What a hostile sampler prints: refused within its limits."""

import io
from typing import Any

import pytest

from rtfiles.errors import UsageError
from rtrun.validity.observations import STATE_LINES_MAX, read_observations, summarize

AT = "at 10.00 0.50 - - cpu 1 2 3 4 5 6 7 8 0 0\n"
THREAD = "thread x 12 1 95 0-1 x\n"


def read(text: str) -> list[Any]:
    return read_observations(io.StringIO(text))


def test_a_state_of_more_lines_than_a_target_has_threads_is_refused():
    (observation,) = read(AT + STATE_LINES_MAX * THREAD + "end\n")
    assert observation.threads == {"x": STATE_LINES_MAX * (("FIFO", 95, frozenset({0, 1})),)}
    with pytest.raises(UsageError, match=r"sampler.stdout:50002: not what sample.sh writes: 'thread x"):
        read(AT + (STATE_LINES_MAX + 1) * THREAD + "end\n")


def test_counts_are_those_of_the_observation_that_they_follow():
    first, second = (f"at {at} 0.1 - - cpu 1 2 3 4 5 6 7 8 0 0\n" for at in (1.0, 3.0))
    observations = read(f"{first}counts\n{second}counts interrupts=7 24:eth0=5\nend\n")
    assert [observation.counts for observation in observations] == ["", "interrupts=7 24:eth0=5"]
    assert observations[1].ticks_by_kind == (1, 2, 3, 4, 5, 6, 7, 8)


@pytest.mark.parametrize("line", ["counts x", "counts x=", "counts x=-1", "counts a b=1", "counts \x1b=1"])
def test_counts_that_the_sampler_does_not_write_are_refused(line):
    with pytest.raises(UsageError, match=r"not what sample.sh writes"):
        read(f"at 1.0 0.1 - - cpu 1 2 3 4 5 6 7 8 0 0\n{line}\n")


def test_a_broken_sensor_says_nothing_and_no_share_leaves_its_range():
    # The time of waiting for disks goes back from 9 to 8.
    lines = (f"at {n} 0.1 41000,-{2**63} - cpu {n} 2 3 9 {9 - n} 6 {n} 8\n{THREAD}end\n" for n in (0, 1))
    observed = summarize(read("".join(lines)), [])
    assert (observed.temperature_mc, observed.busy_percent) == ([41_000, 41_000], 100)


@pytest.mark.parametrize(
    "text",
    [
        AT.replace("10.00", "1e300"), f"{AT}rival 5 1 100 x\nend\n", f"{AT}rival 5 1 -1 x\nend\n",
        f"{AT}thread x 12 1 100 0 x\nend\n", f"{AT}load x {2**22 + 1} 0\nend\n",
        f"{AT}sched_rt_runtime_us {2**31}\nend\n",
    ],
)  # fmt: skip
def test_numbers_that_the_kernel_has_not_are_refused(text):
    with pytest.raises(UsageError, match=r"not what sample.sh writes"):
        read(text)
