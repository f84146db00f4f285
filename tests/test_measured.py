"""The measurer itself: what a program uses is told apart from what whoever measures it uses."""

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

from measured import measured, own_peak_mib

MIB = 2**20
FROM_A_LARGE_PARENT = f"""
ballast = b"x" * (400 * {MIB})
from measured import measured, own_peak_mib
print(own_peak_mib(), measured(["/bin/true"]).peak_mib)
"""


def python(code: str) -> list[str]:
    return [sys.executable, "-I", "-S", "-c", code]


def test_the_parent_is_not_measured():
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(
        [sys.executable, "-c", FROM_A_LARGE_PARENT], env=environment, capture_output=True, text=True, check=True
    )
    parent_mib, child_mib = map(float, done.stdout.split())
    assert parent_mib > 400
    assert 0 < child_mib < 20


def test_the_program_is_measured():
    """Its highest memory, not that at its end, within what an interpreter has."""
    peak_mib = measured(python(f"x = b'x' * (200 * {MIB}); del x")).peak_mib
    assert 200 < peak_mib < 220


def test_so_is_the_largest_that_it_starts():
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', 'b\"x\" * (100 * {MIB})'], check=True)"
    assert 100 < measured(python(code)).peak_mib < 130


def test_a_program_ends_as_it_would():
    done = measured(["sh", "-c", "echo out; echo err >&2; exit 3"], check=False)
    assert (done.status, done.stdout, done.stderr) == (3, "out\n", "err\n")
    assert measured(["sh", "-c", "kill -9 $$"], check=False).status == -9
    missing = measured(["/no/such/program"], check=False)
    assert missing.status == 127 and "/no/such/program" in missing.stderr
    with pytest.raises(subprocess.CalledProcessError, match="exit status 3"):
        measured(["sh", "-c", "exit 3"])


def test_processor_time_is_the_programs():
    code = "import time\nwhile time.process_time() < 0.3: pass"
    assert measured(python(code)).cpu_s >= 0.3


def test_what_takes_too_long_is_ended():
    """The program, too, and not only the process between: both hold the pipe open as long as they live."""
    reading, writing = os.pipe()
    with os.fdopen(reading) as held:
        with os.fdopen(writing, "wb") as output, pytest.raises(subprocess.TimeoutExpired):
            measured(["sleep", "600"], timeout_s=2, output=output)
        assert select.select([held], [], [], 60)[0] == [held] and held.read() == ""


def test_output_may_go_to_a_file(tmp_path):
    with (tmp_path / "log").open("wb") as log:
        assert measured(["sh", "-c", "echo a; echo b >&2"], output=log).stdout == ""
    assert (tmp_path / "log").read_text() == "a\nb\n"


def test_this_process_is_measured():
    assert own_peak_mib() > 10
