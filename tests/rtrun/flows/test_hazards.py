"""What threatens real time is reported for each program, and nothing for one that is as it should be."""

import re

import pytest

from rtrun.flows.hazards import hazards
from rtrun.probes.hits import ObservedProgram, ProgramThread


def program(name, *threads, locked=4096):
    program_threads = tuple(
        ProgramThread(tid=100 + k, name=thread, policy=policy, priority=priority, cpus=tuple(cpus))
        for k, (thread, policy, priority, cpus) in enumerate(threads)
    )
    return ObservedProgram(
        pid=len(name),
        start_ticks=1,
        name=name,
        argv=(name,),
        locked_bytes=locked,
        libraries=(),
        threads=program_threads,
    )


GOOD = program("good", ("main", "FIFO", 80, (0, 1)), ("recv", "FIFO", 70, (0, 1)))


@pytest.mark.parametrize(
    ("other", "sentences"),
    [
        (program("equal", ("main", "FIFO", 70, (0, 1))), set()),
        (program("elsewhere", ("main", "FIFO", 90, (2, 3))), set()),
        (program("slow", ("main", "OTHER", 0, (0,))), {"slow: no thread is real-time"}),
        (
            program("mixed", ("main", "RR", 60, (0,)), ("dds.ev", "OTHER", 0, (0,))),
            {"mixed: 1 thread not real-time: dds.ev"},
        ),
        (program("free", ("main", "FIFO", 50, (3,)), locked=0), {"free: memory is not locked"}),
        (
            program("above", ("loop", "FIFO", 75, (1,))),
            {"good: on the same CPUs with a higher priority: loop of above (FIFO 75)"},
        ),
        (
            program("deadline", ("loop", "DEADLINE", 0, (1,))),
            {"good: on the same CPUs with a higher priority: loop of deadline (DEADLINE 0)"},
        ),
    ],
    ids=lambda case: case.name if isinstance(case, ObservedProgram) else "",
)
def test_each_hazard_is_said_of_the_program_that_has_it(other, sentences):
    lines = {re.sub(r" \(pid \d+\)", "", line) for line in hazards((GOOD, other))}
    # A program below another one is delayed by it, too: only what the case is about counts.
    lines = {line for line in lines if "good (FIFO" not in line}
    assert {next((line for line in lines if line.startswith(text)), text) for text in sentences} == lines


def test_a_hazard_of_several_programs_is_said_once():
    many = [program(f"node{k}", ("main", "OTHER", 0, (0,))) for k in range(6)]
    (line,) = hazards(many)
    assert line.startswith("node0 (pid 5), node1 (pid 5), ") and " and 2 more: no thread is real-time" in line


def test_nothing_goes_before_a_thread_with_a_budget():
    """SCHED_DEADLINE comes before every priority."""
    budget = program("budget", ("loop", "DEADLINE", 0, (0, 1)))
    above = program("above", ("main", "FIFO", 99, (0, 1)))
    assert not [line for line in hazards((budget, above)) if line.startswith("budget")]
