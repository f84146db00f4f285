"""The supervisor of a program, beyond what its users see: tests/rtrun/targets/test_processes.py."""

import shutil
import subprocess
import time
from pathlib import Path

import rtrun
from conftest import apart

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


def test_the_number_of_a_process_that_ended_may_be_anothers(tmp_path: Path) -> None:
    """The deadline ends the program at once; what watched the deadline goes on for five seconds, then cleans up."""
    script = """
        sh "$1" "$2" program 1 "" sh -c 'trap "exit 0" TERM; while :; do sleep 0.01; done'
        until [ -s "$2/program.pid" ]; do sleep 0.01; done
        # Of the two that sleep, the one that is the child of a child of the supervisor.
        until sleeper=$(pgrep --session "$(head -n 1 "$2/program.pid")" --full '^sleep 1$'); do sleep 0.01; done
        until [ -e "$2/program.exit" ]; do sleep 0.01; done
        while :; do
            echo $((sleeper - 1)) >/proc/sys/kernel/ns_last_pid
            setsid sleep 600 &
            [ $! = "$sleeper" ] && break
            kill $!
        done
        while pgrep --session "$(head -n 1 "$2/program.pid")"; do sleep 0.05; done
        kill -0 "$sleeper" && grep -q sleep "/proc/$sleeper/comm"
    """
    subprocess.run([*apart(), "sh", "-c", script, "sh", SCRIPT, tmp_path], check=True, stdout=subprocess.DEVNULL)
