"""Programs that rtgen starts: their output, their errors, and that nothing of them is left."""

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rtfiles.errors import InfrastructureError
from rtgen import process


def test_output_input_folder_and_environment(tmp_path: Path) -> None:
    assert process.run(["cat"], stdin=b"given") == "given"
    assert process.run(["cat"]) == "", "no input, instead of ours"
    script = "pwd; echo $NAME ${HOME-unset}"
    output = process.run(["/bin/sh", "-c", script], folder=tmp_path, environment={"NAME": "x", "PATH": "/usr/bin:/bin"})
    assert output == f"{tmp_path}\nx unset\n"


def test_a_missing_program_is_named() -> None:
    with pytest.raises(InfrastructureError, match=r"^no-such-tool is not installed: `tools/setup all` installs it$"):
        process.run(["no-such-tool", "--version"])


def test_the_last_lines_of_a_failure() -> None:
    with pytest.raises(InfrastructureError) as raised:
        process.run(["sh", "-c", "seq 100; echo wrong >&2; exit 4"])
    lines = str(raised.value).splitlines()
    assert lines[0] == "exit status 4 of sh -c 'seq 100; echo wrong >&2; exit 4'"
    assert len(lines) == 1 + process.SHOWN_LINES and lines[-2:] == ["  100", "  wrong"]
    with pytest.raises(InfrastructureError, match="no output"):
        process.run(["false"])


def test_a_program_that_takes_too_long_may_clean_up(tmp_path: Path) -> None:
    script = f"trap 'touch {tmp_path}/cleaned; exit' TERM; while :; do sleep 0.05; done"
    with pytest.raises(InfrastructureError, match=r"sh did not end within 0\.5 s"):
        process.run(["sh", "-c", script], timeout_s=0.5)
    assert (tmp_path / "cleaned").exists()


def test_what_a_program_leaves_behind_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "GRACE_S", 0.5)
    script = f"trap '' TERM; sleep 1000 & echo $! >{tmp_path}/pid; wait; sleep 1000"
    with pytest.raises(InfrastructureError, match="did not end"):
        process.run(["sh", "-c", script], timeout_s=0.5)
    wait_until_gone(int((tmp_path / "pid").read_text()))


def test_a_program_ends_when_we_are_killed(tmp_path: Path) -> None:
    code = "import sys; from rtgen.process import run; run(['sh', '-c', sys.argv[1]])"
    script = f"echo $$ >{tmp_path}/pid; exec sleep 1000"
    environment = {"PYTHONPATH": ":".join(sys.path), "PATH": "/usr/bin:/bin"}
    parent = subprocess.Popen([sys.executable, "-c", code, script], env=environment)
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        assert parent.poll() is None
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    wait_until_gone(int((tmp_path / "pid").read_text()))


def wait_until_gone(number: int) -> None:
    status = Path(f"/proc/{number}/status")
    # It may go between the question and the reading; pytest's own timeout ends this.
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        while "State:\tZ" not in status.read_text():
            time.sleep(0.02)
