"""What `--help` of both programs imports: commands import in `run` what takes long to load."""

import subprocess
import sys

import pytest

SLOW = {
    "duckdb", "fsspec", "jinja2", "numpy", "paramiko", "plotly", "pyarrow", "pydantic", "rich", "ruptures", "yaml",
}  # fmt: skip
PROGRAM = """
import sys
from {program}.cli import main
status = main({arguments})
print(*sorted({{name.partition(".")[0] for name in sys.modules}}), file=sys.stderr)
sys.exit(status)
"""


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
@pytest.mark.parametrize("program", ["rtrun", "rtgen"])
def test_nothing_slow_is_imported(program: str, arguments: list[str]) -> None:
    code = PROGRAM.format(program=program, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = set(done.stderr.split())
    assert "argparse" in imported
    assert not imported & SLOW
