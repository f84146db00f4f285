"""A target that lies in an answer: what reads it takes neither much memory nor much time, each in a process of its own.

Each lie is as large as its reader lets it come.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

MEMORY_MAX_KIB = 300 * 1024
LIES = {
    "findings": """
facts = rt_readiness.parse(link(b"== rt_runtime\\n", b"99\\n").check(["x"]))
with contextlib.redirect_stdout(open("/dev/null", "w")):
    print_json([_as_json(each) for each in rt_readiness.judge(rt_readiness.read_checks(), facts)])
""",
    "states": """
states = [facts.parse_state(link(b"== %s\\n" % name, word).check(["x"])).model_dump()
          for name, word in ((b"governor", b"ab\\n"), (b"frequency_khz", b"300\\n"))]
json.dumps(states, indent=2)
""",
    "leftovers": """
resumption.inspect_leftovers(link(b"", b"a bb cc\\n"), PurePosixPath("/x"), ["a"], [])
""",
    "kernel symbols": """
kernel_trace.read_symbols(link(b"", b"12345678 T hrtimer_wakeup\\n"))
""",
    "sets of CPUs": """
sampled(AT + "".join(f"thread a {n} 1 9 {n % 8}-{8000 + n % 100} x\\n" for n in range(40_000)) + "end 1\\n")
""",
    "one set of CPUs": """
sampled(AT + "thread a 1 1 9 0-8191 x\\nload x 1 0-8191\\n" * 200 + "end 1\\n")
""",
    "a long set of CPUs": """
sampled(AT + "".join(f"thread a 1 1 9 {n}-8191{',0-8191' * 30_000} x\\n" for n in range(5)) + "end 1\\n")
""",
    "rivals": """
rivals = (f"rival {n} 1 9 n{n}\\n" + (n % 49_000 == 48_999) * f"end 1\\n{AT}" for n in range(441_000))
sampled(AT + "".join(rivals))
""",
    "words": """
sampled(AT + ("x" + " ab" * 100 + "\\n") * 49_000 + "end 1\\n")
""",
    "sensors": """
sampled("at 1 0 " + "300," * 60_000 + "300 - cpu 1 2 3 4 5 6 7 8\\n")
""",
    "observations": """
sampled(AT)
""",
    "files of libraries": """
def fetch(link, file):
    known = libraries().values()
    every = {symbol: 4096 for library in known for probe in library.probes for symbol in probe.symbols}
    return LibrarySymbols(architecture="x86_64", offsets=every)

def look(link, users):
    each = [mapped for _, mapped in users]
    of = placement._LibraryFile
    return (6, 1), {(one.device, one.inode): of(size_bytes=9, sha256=f"{one.inode:064}", path="/x") for one in each}

placement._resolve, placement._look = fetch, look
maps = ["".join(f"\\nmaps 1-2 fe:00 {pid * 16 + n} /{pid}/{n}/librcl.so" for n in range(16)) for pid in range(2001)]
lines = [f"program {pid}\\nstat {pid} (x) S{' 1' * 48}{maps[pid]}\\nend {pid}\\n" for pid in range(1, 2001)]
found = parse_programs("".join(lines), "x").found
assert len(found) == 2000
placed = placement.place(link(b"", b"x"), found, events=list(events()))
assert len({probe.path for probe in placed.probes}) <= 256 and len(placed.refused) < 1000
""",
    "masters and domains": """
now = [0.0]
def wait(argv, deadline_s=30, stdin=""):
    now[0] += 60
    return Completed(status=3, stdout="", stderr="nobody")
ros_graph.time = SimpleNamespace(monotonic=lambda: now[0])
found = [running(n, "librcl") for n in range(1, 2001)]
asked = link(b"", b"x")
asked.check = lambda *_: "".join(f"{n} ROS_DOMAIN_ID={n}\\n" for n in range(1, 2001))
asked.run = wait
graph = ros_graph.read_graph(asked, PurePosixPath("/x"), found)
assert now[0] < 200 and "was not asked" not in graph.remarks[0] and len(graph.remarks) < 10, graph.remarks
""",
    "nodes of many domains": """
told = json.dumps({"nodes": [{"name": f"/{n}", "publishes": [f"/{n}/{m}" for m in range(50)]} for n in range(1500)]})
found = [running(n, "librcl") for n in range(1, 50)]
asked = link(b"", b"x")
asked.check = lambda *_: "".join(f"{n} ROS_DOMAIN_ID={n}\\n" for n in range(1, 50))
asked.run = lambda argv, deadline_s: Completed(status=0, stdout=told, stderr="")
graph = ros_graph.read_graph(asked, PurePosixPath("/x"), found)
assert len(graph.nodes) == 1500 and "more than 2000 nodes" in graph.remarks[0]
""",
    "names that are no texts": """
deep = []
for _ in range(50_000):
    deep = [deep]
ros_graph.roscpp.call = lambda *_: [[["/a", [deep]]], [], []]
found = [running(1, "libroscpp")]
graph = ros_graph.read_graph(link(b"", b"x"), PurePosixPath("/x"), found)
assert "names that are no texts" in graph.remarks[0], graph.remarks
""",
    "records that are none": """
path = Path(sys.argv[1]) / "x.json"
for key in ("in_effect", "indices"):
    path.write_text(json.dumps({key: {"threads": [{}] * 240_000, "missing": [""] * 240_000}}))
    try:
        read_json(path, Record)
    except UsageError as error:
        assert len(str(error)) < 10_000
""",
    "CPUs of threads": """
ranges = "0-8191," * 8191 + "0"
reader = ProgramReader("x")
try:
    for n in range(200):
        for line in (f"program {n + 1}", f"cpus {n + 1} {n},{ranges}", f"end {n + 1}"):
            reader.take(line.encode())
except TargetError:
    pass
""",
    "hits that come late": """
flows = FlowAccumulator(begin_ns=1)
flows.feed(Hit(n + 2, 0, 0, 1 + n, "publish", {"topic": f"/{n}", "endpoint": n, "source_ns": n}) for n in range(9000))
for _ in range(3):
    flows.feed(Hit(1 + n % 9, 0, 0, 1 + n % 9000, "publish", {"topic": "/1", "source_ns": n}) for n in range(100_000))
assert len(flows.gaps) == 3 and flows.in_gaps == 300_000
""",
}
READ = """
import contextlib, json, sys
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from watched import parse_programs
from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtfiles.output import print_json
from rtrun.commands import observe, run
from rtrun.commands.check_rt import _as_json
from rtrun.execution import resumption, ros_graph
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.results.output import Record
from rtrun.probes import placement
from rtrun.probes.hits import Hit
from rtrun.probes.libraries.description import events, libraries
from rtrun.probes.programs import ProgramReader
from rtrun.probes.symbols import LibrarySymbols
from rtrun.targets.address import Address
from rtrun.targets.connection import Completed, Connection
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts, kernel_trace, rt_readiness
from rtrun.targets.shell import CHUNK_BYTES, OUTPUT_BYTES_MAX
from rtrun.validity import observations

AT = "at 1 0 - - cpu 1 2 3 4 5 6 7 8\\n"

def link(head, word):
    "A target that answers with this word, as often as may be."
    connection = Connection.__new__(Connection)
    connection.address = Address(host="board")
    answer = head + word * ((OUTPUT_BYTES_MAX - len(head)) // len(word))

    def execute(argv, stdin, take, deadline_s, feed=None):
        for start in range(0, len(answer), CHUNK_BYTES):
            take(answer[start : start + CHUNK_BYTES])
        return 0, ""

    connection.shell = SimpleNamespace(execute=execute)
    target = SimpleNamespace(address=connection.address, work_dir=PurePosixPath("/v"), setup=None)
    return SimpleNamespace(
        target=target, boot_id="1", check=connection.check, run=connection.run, do=lambda step: step(connection)
    )

def running(pid, library):
    "A program that maps a library."
    return SimpleNamespace(program=SimpleNamespace(pid=pid), mapped=[SimpleNamespace(library=library)])

def sampled(block):
    "What a sampler of an hour prints, this again and again."
    size = observations.output_bytes_max(3600)
    text = Path(sys.argv[1]) / "sampler.stdout"
    with text.open("w") as stream:
        for _ in range(max(1, size // len(block))):
            stream.write(block)
    try:
        seen = observations.observations_of(text.parent)
        observations.summarize(seen, [state for each in seen for states in each.threads.values() for state in states])
    except UsageError as error:
        print(error)

"""


@pytest.mark.timeout(150)
@pytest.mark.parametrize("lie", LIES)
def test_an_answer_that_lies(lie, tmp_path):
    peak = 'print(next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))'
    code = f"{READ}{LIES[lie]}{peak}\n"
    paths = [str(Path(__file__).parents[1]), *sys.path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    limited = ["prlimit", f"--as={4 << 30}", sys.executable, "-c", code, str(tmp_path)]
    ended = subprocess.run(limited, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stderr[-2000:]
    match = re.search(r"^VmHWM:\s+(\d+) kB$", ended.stdout, re.M)
    assert match and int(match[1]) < MEMORY_MAX_KIB, ended.stdout
