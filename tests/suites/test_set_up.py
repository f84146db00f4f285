"""In which order a program of the suites gets memory and priority, and how it ends where its middleware throws."""

import json
import re
import signal
import subprocess
from pathlib import Path

import pytest

from ports import free_domain, give_back_domain

from .conftest import PROGRAMS, Bench, Ended, end, is_measuring, wait_until

pytestmark = pytest.mark.ros

ROWS = 2_000_000
# Bytes of a row of samples, and what the subscriber keeps besides of each message.
ROW_BYTES = {"oneshot_timer_tests": 40, "cyclic_timer_tests": 24, "communication_tests_subscriber": 24.125}
STACK_KIB = 256
HEAP_KIB = 2048
NODE = f"""topology 1
process all 1
measure 1000000000
topic 0 /t 0 reliable 10
executor 0 quick FIFO 20 -
executor 1 slow 0 0 -
node 0 sends 0 period 1000000 0 0 10000000 {ROWS}
out 0 0 1 1
node 1 takes 1 any 0 0 0 0 {ROWS}
in 1 0 {ROWS}
end
"""


def kib_at_first_policy(path: Path) -> dict[str, int]:
    """The sizes in a copy of status and smaps: locked, resident; and of the stack what is in memory, of it alone."""
    text = path.read_text()
    sizes = {name: int(size) for name, size in re.findall(r"^(VmLck|VmRSS):\s+(\d+) kB$", text, re.M)}
    stack = re.search(r"\[stack\]\n(?:\w+:.*\n)*?Rss:\s+(\d+) kB", text)
    assert stack is not None
    return sizes | {"stack": int(stack[1])}


def first_policy(bench: Bench, preloaded: Path, program: str, *arguments: str) -> dict[str, int]:
    seen = bench.folder / "first-policy"
    bench.environment |= {"LD_PRELOAD": str(preloaded / "first_policy"), "FIRST_POLICY": str(seen)}
    process = bench.start(program, "-s", "FIFO", *arguments)
    wait_until(lambda: is_measuring(process) and seen.exists(), process)
    process.send_signal(signal.SIGTERM)
    assert end(process).status in (0, 1)
    return kib_at_first_policy(seen)


def resident_kib_of_samples(program: str) -> int:
    return int(ROWS * ROW_BYTES.get(program, 0)) // 1024 + STACK_KIB + HEAP_KIB


@pytest.mark.root
@pytest.mark.parametrize("scope", ["process", "measuring-thread"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_memory_comes_before_priority(bench: Bench, preloaded: Path, program: str, scope: str) -> None:
    """A thread of real-time priority that has 4 GB filled with zeros keeps everything else from its CPU meanwhile."""
    kib = first_policy(bench, preloaded, program, "-r", str(ROWS), "--rt-scope", scope)
    assert kib["VmLck"] > 0 and kib["stack"] >= STACK_KIB, kib
    assert kib["VmRSS"] > resident_kib_of_samples(program), kib


@pytest.mark.root
@pytest.mark.parametrize("role", ["publisher", "subscriber"])
def test_memory_comes_before_priority_without_ros(bench: Bench, preloaded: Path, role: str) -> None:
    bench.middleware = "tcp"
    bench.environment["ROS_DOMAIN_ID"] = str(domain := free_domain())
    kib = first_policy(bench, preloaded, f"communication_tests_{role}", "-r", str(ROWS))
    give_back_domain(domain)
    assert kib["VmLck"] > 0 and kib["stack"] >= STACK_KIB, kib
    assert kib["VmRSS"] > resident_kib_of_samples(f"communication_tests_{role}"), kib


@pytest.mark.root
def test_memory_comes_before_priority_in_a_graph(bench: Bench, preloaded: Path) -> None:
    (bench.folder / "all.topology").write_text(NODE)
    seen = bench.folder / "first-policy"
    bench.environment |= {"LD_PRELOAD": str(preloaded / "first_policy"), "FIRST_POLICY": str(seen)}
    ended = bench.run("topology_node", "all.topology")
    assert (ended.status, ended.err) == (0, "")
    kib = kib_at_first_policy(seen)
    assert kib["VmLck"] > 0 and kib["stack"] >= STACK_KIB, kib
    # Two tables of activations, of five and six columns, one of receptions, of four, and what a node touches.
    assert kib["VmRSS"] > ROWS * 8 * (5 + 6 + 4) // 1024 + 10_000_000 // 1024 + STACK_KIB + HEAP_KIB, kib
    threads = {thread["name"]: thread for thread in record_of(bench.folder)["in_effect"]["threads"]}
    assert (threads["quick"]["policy"], threads["quick"]["priority"]) == ("FIFO", 20)
    assert threads["slow"]["policy"] == "OTHER"


def record_of(folder: Path) -> dict:  # type: ignore[type-arg]
    (path,) = folder.glob("*.json")
    return json.loads(path.read_text())  # type: ignore[no-any-return]


def test_a_publisher_whose_send_throws_ends_with_an_error(bench: Bench, preloaded: Path) -> None:
    bench.environment |= {"LD_PRELOAD": str(preloaded / "throwing_roscpp"), "THROWS": "publish"}
    ended = bench.run("communication_tests_publisher", "-r", "100")
    assert (ended.status, ended.err) == (1, "\tERROR: roscpp: cannot publish: planted after 4 of 100 messages\n")
    record = record_of(bench.folder)
    assert (record["complete"], record["incomplete_reason"]) == (False, "roscpp: cannot publish: planted")
    assert record["counts"] == {"asked": 100, "sent": 4}


@pytest.mark.root
def test_a_node_whose_send_throws_ends_with_an_error(bench: Bench, preloaded: Path) -> None:
    (bench.folder / "all.topology").write_text(NODE)
    bench.environment |= {"LD_PRELOAD": str(preloaded / "throwing_roscpp"), "THROWS": "publish"}
    ended = bench.run("topology_node", "all.topology")
    assert (ended.status, ended.err) == (1, "\tERROR: roscpp: cannot publish: planted\n")
    record = record_of(bench.folder)
    assert (record["complete"], record["incomplete_reason"]) == (False, "roscpp: cannot publish: planted")


@pytest.mark.root
@pytest.mark.parametrize(
    ("program", "thread"),
    [(program, "main") for program in PROGRAMS if program != "communication_tests_publisher"]
    + [("oneshot_timer_tests", "other"), ("topology_node", "other")],
)
def test_a_thread_that_throws_ends_its_program_with_an_error(
    bench: Bench, preloaded: Path, program: str, thread: str
) -> None:
    """Whichever thread it is: an exception that nobody catches would be the end of the process, by SIGABRT."""
    (bench.folder / "all.topology").write_text(NODE)
    bench.environment |= {"LD_PRELOAD": str(preloaded / "throwing_roscpp"), "THROWS": thread}
    arguments = ["all.topology"] if program == "topology_node" else ["-r", "100000"]
    # The first shot, and all of a one-shot in busy mode, are waited for by the main thread.
    arguments += ["-b", "1"] if (program, thread) == ("oneshot_timer_tests", "main") else []
    ended: Ended = bench.run(program, *arguments)
    assert (ended.status, ended.err) == (1, "\tERROR: planted\n")


def test_the_calls_that_throw_are_those_of_roscpp(bench: Bench) -> None:
    """The names in preloaded/throwing_roscpp.cpp are those that the programs look for."""
    source = (Path(__file__).parent / "preloaded/throwing_roscpp.cpp").read_text()
    for program, names in {"communication_tests_publisher": "PUBLISH", "cyclic_timer_tests": "WAIT"}.items():
        (path,) = bench.suites.glob(f"lib/*/{program}")
        wanted = subprocess.run(["nm", "-D", "-u", path], capture_output=True, text=True, check=True).stdout
        name = re.search(rf'#define {names} "(\w+)"', source)
        assert name is not None and f" {name[1]}" in wanted
