"""`rtrun quick --thread`: a first answer about the loop of a program that runs, unmodified."""

import json
import re
import subprocess

import pytest
from probes.standin import running

from rtrun.cli import main

pytestmark = [pytest.mark.trace, pytest.mark.root, pytest.mark.timeout(180)]
LOOP = """
#include <time.h>
int main(void) {
    struct timespec due;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (;;) {
        due.tv_nsec += 5000000;
        if (due.tv_nsec >= 1000000000) due.tv_nsec -= 1000000000, due.tv_sec++;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, 0);
    }
}
"""


@pytest.fixture
def quick(tmp_path, monkeypatch, capsys):
    """Call it in an empty folder; returns its status, what it printed, and the errors."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        status = main(["quick", *words])
        return status, *capsys.readouterr()

    return call


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """The path of a program whose only thread has a period of 5 ms and no real-time policy."""
    program = tmp_path_factory.mktemp("servo") / "servo-of-quick"
    subprocess.run(["cc", "-O1", "-xc", "-", "-o", program], input=LOOP, text=True, check=True)
    return program


def test_a_loop_that_runs_gets_a_first_answer(quick, servo):
    with running(servo):
        status, printed, errors = quick("--thread", servo.name, "--deadline", "10s", "--for", "4s")
    assert status == 0, printed + errors
    heading, _, rows = printed.partition(" How many are late, 95 % sure:\n")
    assert heading.splitlines()[-1].startswith("10 s was never missed in 2 tests on "), printed
    assert len(re.findall(r"^loop +none of \d+ late, ", rows, re.M)) == 2, printed
    assert f"loop-response {servo.name}" in rows and "At most 1 in 100 late? " in rows


def test_without_a_deadline_the_loop_alone_has_figures(quick, servo):
    with running(servo):
        status, printed, errors = quick("--thread", servo.name, "--for", "2s", "--json")
    assert status == 0, printed + errors
    data = json.loads(printed)
    assert data["deadline_ns"] is None
    assert {group["group"].split("/")[0] for group in data["groups"]} == {
        f"loop {servo.name}",
        f"loop-response {servo.name}",
    }
    assert all(group["n"] > 0 and group["misses"] is None for group in data["groups"])


def test_a_loop_that_is_not_there_is_no_answer(quick):
    status, printed, _ = quick("--thread", "no-such-loop", "--for", "2s")
    assert status == 3 and "Nothing was measured that counts." in printed
    assert "failed: loop no-such-loop: it was not seen" in printed


def test_nothing_else_is_measured_beside_it(quick):
    status, _, errors = quick("--thread", "servo", "--suite", "cyclictest")
    assert status == 2 and errors.startswith("rtrun: --thread measures a program that runs: leave out --suite")
