"""The command line that cyclictest's JSON carries, read as cyclictest reads it."""

import shutil
import subprocess
from pathlib import Path

import pytest

from rtfiles.errors import UsageError
from rtrun.results.importers.command_line import COMMAND_MAX, OPTIONS_MAX, read_command

PATH = Path("c.json")


def asked(words, threads=2):
    return read_command(PATH, "cmdline", f"cyclictest {words}").parameters(threads)


DEFAULT = {"policy": "0", "interval_us": 1000, "threads": 2, "cpu_dma_latency_us": 0}


@pytest.mark.parametrize(
    ("words", "changed"),
    [
        ("-q -t2 -h400 -l 1000 -D 5m -v -u -M -R -o 2 -d 0 --json=x --histfile y -F /tmp/f", {}),
        ("-t 2 -a 0-1 --affinity=3 -S --threads", {}),
        ("--policy=fifo --priority=99 --interval=200", {"policy": "FIFO", "priority": 99, "interval_us": 200}),
        ("--policy fifo --priority 99 --interval 200", {"policy": "FIFO", "priority": 99, "interval_us": 200}),
        ("--pol=rr --prior=5 --int=200", {"policy": "RR", "priority": 5, "interval_us": 200}),
        ("-qp99 -i200", {"policy": "FIFO", "priority": 99, "interval_us": 200}),
        ("-i 200 -i300 -p 1 -p2", {"interval_us": 300, "policy": "FIFO", "priority": 2}),
        ("-p 80 --policy=RR", {"policy": "RR", "priority": 80}),
        ("-p 80 --policy=other", {"policy": "FIFO", "priority": 80}),
        ("--policy=other -p 0", {"policy": "FIFO", "priority": 3}),
        ("-p 0 --policy=other", {}),
        ("-p 0 --policy=other -p 0", {"policy": "FIFO", "priority": 3}),
        ("--policy=fifo", {"policy": "FIFO", "priority": 3}),
        ("--priospread", {"policy": "FIFO", "priority": 3, "options": "--priospread"}),
        ("--policy=batch", {"policy": "BATCH"}),
        ("--policy=normal", {}),
        ("--policy=nonsense", {}),
        ("--latency=50", {"cpu_dma_latency_us": 50}),
        ("--laptop", {"cpu_dma_latency_us": None, "options": "--laptop"}),
        ("-mr -c1", {"options": "--clock=1 --mlockall --relative"}),
        ("--relative --clock 1 --mlockall -q", {"options": "--clock=1 --mlockall --relative"}),
        ("-A 100 -x", {"options": "--aligned=100 --posix_timers"}),
        ("-b 50 --tracemark", {"options": "--breaktrace=50 --tracemark"}),
        # A word that no version knows, and what an ambiguous beginning stands for, tell runs apart as they are.
        ("-n --numa -qYz 7 --pri=9", {"options": "-n --numa -Yz 7 --pri=9"}),
    ],
)
def test_what_is_asked_for(words, changed):
    assert asked(words) == DEFAULT | changed


def test_the_histogram_and_its_unit():
    for words in ("-mqh400", "-h 400", "--histogram=400", "-H400", "--histofall 400", "-h1 -H400"):
        command = read_command(PATH, "cmdline", f"cyclictest {words}")
        assert command.limit == 400 and not command.nanoseconds
    assert read_command(PATH, "cmdline", "cyclictest -qN").nanoseconds
    assert read_command(PATH, "cmdline", "cyclictest --ns").nanoseconds
    assert read_command(PATH, "cmdline", "cyclictest -i 200").limit is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-p 100", "--priority '100': expected a whole number from 0 to 99"),
        ("-i 0", "--interval '0': expected a whole number from 1 to 60000000"),
        ("-i 99999999999999999999", "--interval '9+': expected"),
        ("-q ", "cut off: what else was asked for is not known"),
        ("-q" * COMMAND_MAX, f"expected one line of at most {COMMAND_MAX} printable"),
        ("\x1b[2J", "printable characters, got"),
        ("\n-q", "printable characters, got"),
        (f"-c {'1' * OPTIONS_MAX}", f"more than {OPTIONS_MAX} characters of options"),
    ],
)
def test_what_no_command_line_has(words, message):
    with pytest.raises(UsageError, match=rf"c\.json: cmdline: .*{message}"):
        asked(words)


@pytest.mark.root
def test_a_command_line_that_rt_tests_cut_is_refused(tmp_path):
    program = shutil.which("cyclictest", path="/usr/bin:/usr/sbin")
    assert program, "apt-get install rt-tests"
    result = tmp_path / "c.json"
    command = [program, *["-q"] * 1400, "-l", "20", "-h", "400", f"--json={result}"]
    subprocess.run(command, capture_output=True, check=True, timeout=60)
    line = next(line for line in result.read_text().splitlines() if '"cmdline:"' in line).split('": "')[1][:-2]
    with pytest.raises(UsageError, match="cut off"):
        read_command(PATH, "cmdline", line)
