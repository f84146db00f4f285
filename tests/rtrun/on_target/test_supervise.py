"""The supervisor of a program, beyond what its users see: tests/rtrun/target/test_processes.py."""

import shutil
import subprocess
import time
from pathlib import Path

import rtrun

SCRIPT = Path(rtrun.__file__).parent / "on_target/supervise.sh"


def test_a_program_ends_at_its_deadline_though_its_folder_is_gone(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    subprocess.run(["sh", SCRIPT, folder, "program", "1", "", "sleep", "600"], check=True)
    while not (folder / "program.stderr").exists():
        time.sleep(0.01)
    supervisor = int((folder / "program.pid").read_text())
    shutil.rmtree(folder)
    # Its session ends with it; pytest's own limit ends a wait that is in vain.
    while (
        subprocess.run(["pgrep", "--session", str(supervisor)], stdout=subprocess.DEVNULL, check=False).returncode == 0
    ):
        time.sleep(0.05)
    assert not Path(f"/proc/{supervisor}").exists()
