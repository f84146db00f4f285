"""The fuzz with fixed seeds, in processes of their own: their memory is measured.

So many rounds, not so long: each machine sees the same inputs.
"""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("seed", [1, 2])
def test_no_reader_fails_on_damaged_input(seed):
    script = Path(__file__).with_name("fuzz.py")
    argv = [sys.executable, script, "--rounds", "10", "--seed", str(seed)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
