"""What the sampler saw, held against the highest values of a run."""

import json

import numpy as np
import pytest
from report.campaigns import cyclic_rows, latencies, write_run
from written import close

from rtfiles.errors import UsageError
from rtrun.causes.surroundings import find_unusual
from rtrun.cli import main
from rtrun.results.record import read_record

OBSERVATIONS, STEP_S, HZ = 150, 2, 50
STATE = {"threads": 0, "rt_threads": []}


def write_sampled(root, *, clocks_apart_s=0.0, planted="24:eth0", outlying=True):
    """A run of five minutes; in some intervals values are late, and there `planted` counts 4000 instead of 100."""
    random = np.random.default_rng(6)
    late = random.random(OBSERVATIONS) < 0.07
    values_ns = latencies(OBSERVATIONS * STEP_S * HZ, 1)
    if outlying:
        values_ns[np.flatnonzero(late) * STEP_S * HZ + HZ] += 900_000
    rows = cyclic_rows(values_ns, HZ) + 100 * 10**9  # after the target's boot by any clock
    folder = write_run(root, "001-run", "cyclic_timer_tests", [rows], {"frequency_hz": HZ}, asked=values_ns.size)
    begin_s = int(np.load(next(folder.glob("*.npy")))[0, 0]) / 1e9 - clocks_apart_s
    lines = []
    for number in range(OBSERVATIONS + 1):
        busy = 100 * number
        temperature = 40_000 + 100 * number + int(random.integers(0, 500))
        counts = {"context_switches": 2000 + random.integers(0, 500), "interrupts": 1000 + random.integers(0, 50)}
        counts[planted] = 4000 if number and late[number - 1] else 100 + random.integers(0, 20)
        words = " ".join(f"{name}={count}" for name, count in counts.items())
        at = f"at {begin_s + STEP_S * number:.2f} 0.5 {temperature} 1000000 cpu {busy} 0 {busy} {busy} 0 0 0 0 0 0"
        lines += [at, f"counts {words}" if number else "counts"]
    (folder / "sampler.stdout").write_text("\n".join(lines) + "\n")
    around = {"before": begin_s - 0.5, "after": begin_s + STEP_S * OBSERVATIONS + 0.5}
    states = {when: STATE | {"uptime": f"{at_s:.2f} 9.0"} for when, at_s in around.items()}
    (folder / "target.json").write_text(json.dumps({"schema": 1, **states, "own_service": True}))
    close(folder, "sampler.stdout", "target.json")
    return folder


def unusual(folder):
    return list(find_unusual(folder, read_record(folder)))


# A clock that is not disciplined by NTP is ahead or behind by this after some weeks.
@pytest.mark.parametrize("clocks_apart_s", [0.0, 40.0, -40.0])
def test_the_interrupt_that_came_with_the_late_values_is_named(tmp_path, clocks_apart_s):
    (found,) = unusual(write_sampled(tmp_path, clocks_apart_s=clocks_apart_s))
    assert (found.quantity, found.unit) == ("24:eth0", "a second")
    assert found.p_value <= 0.01 and found.late > 1000 > 100 > found.otherwise
    assert found.tried == 4, "three counts and the temperature; what never changes is not tried"


def test_where_nothing_came_with_them_nothing_is_named(tmp_path):
    assert unusual(write_sampled(tmp_path, outlying=False)) == []


def test_why_and_the_report_print_it(tmp_path, capsys):
    root = tmp_path / "results"
    write_sampled(root)
    assert main(["why", str(root)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "What else was unusual when the highest values came: 24:eth0, in 1 output" in lines
    assert main(["report", str(root), "--output", "-", "--format", "markdown"]) == 0
    assert "## What else was unusual when the highest values came" in capsys.readouterr().out


def test_a_short_run_and_one_without_sampler_are_left_out(tmp_path):
    folder = write_sampled(tmp_path / "short")
    text = (folder / "sampler.stdout").read_text()
    (folder / "sampler.stdout").write_text("\n".join(text.splitlines()[:100]) + "\n")
    close(folder, "sampler.stdout")
    assert unusual(folder) == []
    rows = cyclic_rows(latencies(2000, 1), HZ)
    plain = write_run(tmp_path, "002-run", "cyclic_timer_tests", [rows], {"frequency_hz": HZ}, asked=2000)
    assert unusual(plain) == []


def test_a_record_that_was_altered_is_refused(tmp_path):
    folder = write_sampled(tmp_path)
    with (folder / "sampler.stdout").open("a") as stream:
        stream.write("x\n")
    with pytest.raises(UsageError, match="altered since the run was closed"):
        unusual(folder)
