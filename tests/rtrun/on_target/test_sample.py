"""The sampler that runs on the target, ended at any moment."""

import os
import signal
import subprocess
import time

from rtrun.target.deploy import ON_TARGET
from rtrun.validity.observations import read_observations

SAMPLERS = 40


def test_it_counts_from_one_observation_to_the_next(tmp_path):
    """The kernel counts interrupts of its own accord: two seconds later there are more."""
    output = tmp_path / "out"
    with output.open("wb") as stream:
        sampler = subprocess.Popen(
            ["sh", str(ON_TARGET / "sample.sh"), str(tmp_path), "95", ""], stdout=stream, stderr=subprocess.DEVNULL
        )
    try:
        deadline = time.monotonic() + 60
        while output.read_text().count("\ncounts") < 2:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        sampler.terminate()
        sampler.wait(60)
    first, second = read_observations(output.read_text())[:2]
    assert f"\nend {first.until_s:.2f}\n" in output.read_text() and first.until_s >= first.uptime_s > 0
    assert first.counts == ""
    counts = dict(word.split("=") for word in second.counts.split())
    assert {"context_switches", "interrupts"} <= set(counts)
    assert len(counts) > 2, "each interrupt line that has counted"
    assert all(int(number) > 0 for number in counts.values())


def test_ended_at_any_moment_it_leaves_whole_lines(tmp_path):
    argv = ["sh", str(ON_TARGET / "sample.sh"), str(tmp_path), "95", ""]
    samplers = [
        subprocess.Popen(
            argv, stdout=(tmp_path / f"{number}.out").open("wb"), stderr=subprocess.DEVNULL, process_group=0
        )
        for number in range(SAMPLERS)
    ]
    deadline = time.monotonic() + 60
    while not any("at " in (tmp_path / f"{number}.out").read_text() for number in range(SAMPLERS)):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    for sampler in samplers:
        os.killpg(sampler.pid, signal.SIGTERM)
        time.sleep(0.03)
    for sampler in samplers:
        sampler.wait(60)
    lines = [line for number in range(SAMPLERS) for line in (tmp_path / f"{number}.out").read_text().splitlines()]
    looks = [line.split() for line in lines if line.startswith("at ")]
    assert looks, "some of them had time for a look"
    assert [words for words in looks if len(words) < 14 or words[5] != "cpu"] == []
