"""The two samplers, the program of the suites and the script: alike, and ended at any moment."""

import io
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import kernel_threads_hidden
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.inspection.facts import parse_state
from rtrun.validity.observations import COUNTS_MAX, Observation, observations_of, read_observations

SCRIPT = ["sh", str(ON_TARGET / "sample.sh")]
SAMPLERS = 40
# Names of programs.
BRACKETS, BLANKS, BACKSLASH = "a) R 1 (b", "two  blanks", "x\\ny"
# As it is printed: it begins with a line end, and would end the state.
LINE_END = "\\nend 1.0"


@pytest.fixture(params=["program", "script"])
def sampler(request: pytest.FixtureRequest) -> list[str]:
    return SCRIPT if request.param == "script" else [str(request.getfixturevalue("sampler_program"))]


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def observations_in(text: str) -> list[Observation]:
    return read_observations(io.StringIO(text))


def test_it_counts_from_one_observation_to_the_next(sampler, tmp_path):
    """The kernel counts interrupts of its own accord: two seconds later there are more."""
    output = tmp_path / "sampler.stdout"
    with output.open("wb") as stream:
        process = subprocess.Popen([*sampler, str(tmp_path), "95", ""], stdout=stream)
    try:
        wait_until(lambda: output.read_text().count("\ncounts") >= 2)
    finally:
        process.terminate()
        assert process.wait(60) == 0
    first, second = observations_of(tmp_path)[:2]
    assert f"\nend {first.until_s:.2f}\n" in output.read_text() and first.until_s >= first.uptime_s > 0
    assert first.counts == ""
    counts = dict(word.split("=") for word in second.counts.split())
    assert {"context_switches", "interrupts"} <= set(counts)
    assert len(counts) > 2, "each interrupt line that has counted"
    assert all(int(number) > 0 for number in counts.values())


def test_ended_at_any_moment_it_leaves_whole_lines(sampler, tmp_path):
    samplers = [
        subprocess.Popen(
            [*sampler, str(tmp_path), "95", ""],
            stdout=(tmp_path / f"{number}.out").open("wb"),
            stderr=subprocess.DEVNULL,
            process_group=0,
        )
        for number in range(SAMPLERS)
    ]
    wait_until(lambda: any("at " in (tmp_path / f"{number}.out").read_text() for number in range(SAMPLERS)))
    for process in samplers:
        os.killpg(process.pid, signal.SIGTERM)
        time.sleep(0.03)
    for process in samplers:
        process.wait(60)
    lines = [line for number in range(SAMPLERS) for line in (tmp_path / f"{number}.out").read_text().splitlines()]
    looks = [line.split() for line in lines if line.startswith("at ")]
    assert looks, "some of them had time for a look"
    assert [words for words in looks if len(words) < 14 or words[5] != "cpu"] == []


def test_it_ends_with_the_folder_of_its_run(sampler, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    process = subprocess.Popen([*sampler, str(folder), "95", ""], stdout=subprocess.DEVNULL)
    folder.rmdir()
    assert process.wait(60) in (0, 1), "1: it was removed before the sampler had found it"


def test_the_program_starts_no_other_and_costs_little(sampler_program, tmp_path):
    """What the kernel accounts to it and to children that it has waited for."""
    process = subprocess.Popen([sampler_program, str(tmp_path), "95", ""], stdout=(tmp_path / "out").open("wb"))
    wait_until(lambda: (tmp_path / "out").read_text().count("at ") >= 2)
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    assert Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text() == ""
    assert fields[13:15] == ["0", "0"], "CPU time of children (proc(5), 16 and 17)"
    assert fields[16] == "19", "nice"
    process.terminate()
    assert process.wait(60) == 0


# Programs as supervise.sh starts them: leaders of a session that is known by NAME.pid.
PROGRAMS = f"""
begin() {{ setsid sh -c 'echo $$ >"$0.pid"; exec "$@"' "$@" & }}
cp "$(command -v sleep)" '{BRACKETS}'; cp '{BRACKETS}' '{BLANKS}'; cp '{BRACKETS}' '{BACKSLASH}'; cp '{BRACKETS}' lower
chrt -f 96 './{BRACKETS}' 500 &
chrt -r 95 './{BLANKS}' 500 &
chrt -d --sched-runtime 1000000 --sched-deadline 50000000 --sched-period 100000000 0 './{BACKSLASH}' 500 &
chrt -f 94 ./lower 500 &
chrt -f 96 python3 -c 'import time
open("/proc/self/comm", "w").write("\\nend 1.0")
time.sleep(500)' &
chrt -f 97 python3 -c 'import os, time
os.fork() or os._exit(0)
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
time.sleep(500)' &
begin suite taskset -c 0 python3 -c 'import threading, time
threads = [threading.Thread(target=time.sleep, args=(500,)) for _ in range(3)]
[thread.start() for thread in threads]'
begin measuring chrt -f 95 './{BLANKS}' 500
begin stress taskset -c 0 sh -c './lower 500 & ./lower 500 & wait'
begin sampler chrt -f 96 ./lower 500
begin held ./lower 500
"""


def blocks(text: str) -> list[list[str]]:
    """The states that were printed; the order of their lines says nothing."""
    found: list[list[str]] = []
    block: list[str] = []
    for line in text.splitlines(keepends=True):
        if line.startswith(("at ", "counts")):
            block = []
        elif line.startswith("end "):
            found.append(sorted(block))
        else:
            block.append(line)
    return found


def test_program_and_script_print_the_same(sampler_program, tmp_path):
    """Beside each other on one machine that has no other programs, first without any."""
    argv = {"program": [str(sampler_program)], "script": SCRIPT}
    outputs = {name: tmp_path / f"{name}.out" for name in argv}
    folder = tmp_path / "run"
    folder.mkdir()
    with kernel_threads_hidden(folder) as enter:
        for name, words in argv.items():
            with outputs[name].open("wb") as stream:
                subprocess.Popen([*enter, *words, str(folder), "95", "stress held"], stdout=stream)
        wait_until(lambda: all("\nend " in path.read_text() for path in outputs.values()))
        subprocess.run([*enter, "sh", "-c", PROGRAMS], check=True, stdout=subprocess.DEVNULL)
        expected = {"suite": 4, "measuring": 1}

        def is_seen(path: Path) -> bool:
            last = observations_in(path.read_text())[-1]
            return (
                {name: len(threads) for name, threads in last.threads.items()} == expected
                and {name: count for name, (count, _) in last.loads.items()} == {"stress": 3, "held": 1}
                and len(last.rivals) == 4
            )

        wait_until(lambda: all(is_seen(path) for path in outputs.values()))
        printed = {
            name: subprocess.run([*enter, "sh", ON_TARGET / name], check=True, capture_output=True, text=True).stdout
            for name in ("state.sh", "check_rt.sh")
        }
    texts = [path.read_text() for path in outputs.values()]
    for text in texts:
        assert blocks(text)[0] == blocks(texts[0])[0] and len(blocks(text)[0]) == 2, "nothing but settings"
        assert blocks(text)[-1] == blocks(texts[0])[-1]
        assert "" not in text.splitlines()
    last = observations_in(texts[0])[-1]
    # Of whatever reads names: the whole name is on one line, and a zombie is none.
    threads = {(thread.name, thread.priority) for thread in parse_state(printed["state.sh"]).rt_threads}
    assert threads >= {(BRACKETS, 96), (LINE_END, 96)} and 97 not in {priority for _, priority in threads}
    assert f"96 program {LINE_END}\n" in printed["check_rt.sh"] and "\n97 program" not in printed["check_rt.sh"]
    assert {
        (thread.name, thread.policy, thread.priority, thread.runtime_ns, thread.period_ns) for thread in last.rivals
    } == {
        (LINE_END, "FIFO", 96, None, None),
        (BRACKETS, "FIFO", 96, None, None),
        (" ".join(BLANKS.split()), "RR", 95, None, None),
        (BACKSLASH, "DEADLINE", 0, 1_000_000, 100_000_000),
    }
    assert f" {BLANKS}\n" in texts[0]
    assert last.threads["measuring"][0][:2] == ("FIFO", 95)
    assert last.loads["stress"][1] == frozenset({0})
    assert {cpus for _, _, cpus in last.threads["suite"]} == {frozenset({0})}


@pytest.mark.root
def test_program_and_script_count_the_same(sampler_program, tmp_path):
    """Interrupts as a large server has them, of hostile names: no more than the reader takes."""
    lines = [f"{number}: {95 + number} 0 IO-APIC-edge a b\x07_{'y' * 40}" for number in range(600)]
    before = "\n".join(["     CPU1 CPU3", "NMI: 3 4 Non-maskable interrupts", *lines]) + "\n"
    after = before.replace(" 0 IO", " 7 IO").replace(" 4 Non", " 9 Non")
    interrupts, argv = tmp_path / "interrupts", {"program": [str(sampler_program)], "script": SCRIPT}
    outputs = {name: tmp_path / f"{name}.out" for name in argv}
    interrupts.write_text(before)
    mount = ["unshare", "--mount", "sh", "-c", 'mount --bind "$0" /proc/interrupts && exec "$@"', str(interrupts)]
    processes = []
    for name, words in argv.items():
        with outputs[name].open("wb") as stream:
            processes.append(subprocess.Popen([*mount, *words, str(tmp_path), "95", ""], stdout=stream))
    wait_until(lambda: all("\ncounts" in path.read_text() for path in outputs.values()))
    interrupts.write_text(after)
    wait_until(lambda: all(path.read_text().count("\ncounts") >= 3 for path in outputs.values()))
    for process in processes:
        process.terminate()
        process.wait(60)
    found = []
    for path in outputs.values():
        counts = [observation.counts.split() for observation in observations_in(path.read_text())]
        assert all(len(words) < COUNTS_MAX for words in counts)
        found.append({word for words in counts for word in words if word[0].isdigit() or word.startswith("NMI")})
    assert found[0] == found[1] and len(found[0]) > 500
    assert {"NMI=5", f"7:b__{'y' * 27}=7"} <= found[0]


@pytest.mark.root
def test_interrupts_of_a_cpu_that_comes_back_online_are_not_new(sampler, tmp_path):
    """/proc/interrupts has a column for each CPU that is online, with all that it ever counted."""
    states = [
        "     CPU1 CPU3\nNMI: 3 4000 a\n7: 5 6000 b\n",
        "     CPU1\nNMI: 3 a\n7: 5 b\n",
        "     CPU1 CPU3\nNMI: 3 4000 a\n7: 5 6000 b\n",
        "     CPU1 CPU2\nNMI: 3 9000 a\n7: 5 9000 b\n",  # another one: as many columns
        "     CPU1 CPU2\nNMI: 3 9002 a\n7: 5 9000 b\n",
    ]
    interrupts, output = tmp_path / "interrupts", tmp_path / "sampler.stdout"
    interrupts.write_text(states[0].ljust(80, "\n"))
    mount = ["unshare", "--mount", "sh", "-c", 'mount --bind "$0" /proc/interrupts && exec "$@"', str(interrupts)]
    with output.open("wb") as stream:
        process = subprocess.Popen([*mount, *sampler, str(tmp_path), "95", ""], stdout=stream)
    for number, state in enumerate(states):
        with interrupts.open("r+") as file:  # at once: whoever reads meanwhile never finds it empty
            file.write(state.ljust(80, "\n"))
        # An observation that had begun before may have read the state before.
        seen = output.read_text().count("\ncounts")
        wait_until(lambda least=seen + 1 + (number > 0): output.read_text().count("\ncounts") >= least)
    process.terminate()
    process.wait(60)
    words = [word for observation in observations_in(output.read_text()) for word in observation.counts.split()]
    assert [word for word in words if word.startswith(("NMI", "7:"))] == ["NMI=2"]
    assert any(word.startswith("interrupts=") for word in words), "of all CPUs, also those that are offline"
