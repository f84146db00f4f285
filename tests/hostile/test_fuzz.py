"""The fuzz with fixed seeds, in processes of their own: their memory is measured. And what it has found, by name.

So many rounds, not so long: each machine sees the same inputs.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hostile import readers
from rtfiles.errors import UsageError
from rtrun.cli import main


@pytest.mark.parametrize("seed", [1, 2])
def test_no_reader_fails_on_damaged_input(seed):
    script = Path(__file__).with_name("fuzz.py")
    argv = [sys.executable, script, "--rounds", "10", "--seed", str(seed)]
    environment = {**os.environ, "PYTHONPATH": f"{TOP / 'runner'}:{TOP / 'tests'}"}
    done = subprocess.run(argv, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr


TOP = Path(__file__).parents[2]
CYCLIC, ONESHOT = "cyclic_timer_tests_l100_fq700-tnRTFIFO", "oneshot_timer_tests_l100_tm1000-tnRTRR"


@pytest.fixture(scope="module")
def runs():
    """Files of whole run directories, by suite."""
    return {json.loads(files["run.json"])["suite"]: files for files in readers._runs()}


def refused_by(folder, command, capsys):
    """What a command says of a run directory that it refuses; no command ends with the status of a defect."""
    readers.READERS["commands"].seal(folder)
    readers.READERS["commands"].read(folder)
    capsys.readouterr()
    assert main([command, str(folder)]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        (f"{CYCLIC}.json", "requested.frequency_hz", 2**62),
        (f"{CYCLIC}.json", "in_effect.clock_step_ns", 2**63 - 1),
        (f"{CYCLIC}.json", "in_effect.threads.0.priority", 100),
        (f"{CYCLIC}.json", "counts.asked", 10**8 + 1),
        (f"{ONESHOT}.json", "counts.asked", 50),
        ("run.json", "in_effect.temperature_mc", [1]),
        ("run.json", "in_effect.temperature_mc.0", -(2**63)),
        ("run.json", "start_time", "0001-01-01T00:00:00+14:00"),
        ("run.json", "parameters.repetitions", 10**12),
        ("target.json", "before.uptime", "since Tuesday"),
        ("target.json", "after.uptime", "1e300 2"),
    ],
)
def test_a_number_beyond_its_limit_is_refused_where_it_is_read(tmp_path, capsys, runs, name, place, value):
    for file, content in runs["oneshot_timer_tests" if "oneshot" in name else "cyclic_timer_tests"].items():
        (tmp_path / file).write_bytes(content)
    data = json.loads((tmp_path / name).read_text())
    *parents, last = (int(word) if word.isdigit() else word for word in place.split("."))
    parent = data
    for word in parents:
        parent = parent[word]
    parent[last] = value
    (tmp_path / name).write_text(json.dumps(data))
    refusal = refused_by(tmp_path, "why" if name == "target.json" else "show", capsys)
    assert f"{tmp_path / name}: {place.partition('.')[0]}" in refusal


@pytest.mark.parametrize("value", [2**61, -(2**61), 10**18 + 1])
@pytest.mark.parametrize("suite", ["cyclic_timer_tests", "oneshot_timer_tests", "communication_tests"])
def test_a_time_beyond_its_limit_is_refused_where_it_is_read(tmp_path, capsys, runs, suite, value):
    for file, content in runs[suite].items():
        (tmp_path / file).write_bytes(content)
    (npy,) = tmp_path.glob("*.npy")
    rows = np.load(npy)
    rows[7, 0] = value
    np.save(npy, rows)
    assert f"{npy}: a time beyond" in refused_by(tmp_path, "show", capsys)


def test_times_of_a_graph_lie_after_the_start_of_the_target(tmp_path):
    """What lies between two of its times is written as one: of times on both sides of zero it was none."""
    files = readers.READERS["tables"].seeds[0]
    for name, text in files.items():
        (tmp_path / name).write_bytes(text)
    rows = np.load(tmp_path / "b-0.npy")
    rows[0, 1] = -(10**18)
    np.save(tmp_path / "b-0.npy", rows)
    with pytest.raises(UsageError, match=r"b-0.npy: a time before the target started cannot be"):
        readers.READERS["tables"].read(tmp_path)
