"""What watch_probes.sh prints, made up: pages of the ring buffer as the kernel makes them, and lines around them."""

import struct
from dataclasses import replace

from rtrun.probes.libraries.description import Named
from rtrun.probes.placement import PlacedProbe
from rtrun.probes.programs import FoundPrograms, ProgramReader

HEADER = """\tfield: u64 timestamp;\toffset:0;\tsize:8;\tsigned:0;
\tfield: local_t commit;\toffset:8;\tsize:{size};\tsigned:1;
\tfield: int overwrite;\toffset:8;\tsize:1;\tsigned:1;
\tfield: char data;\toffset:{data};\tsize:{left};\tsigned:1;
"""
HEADERS = {64: HEADER.format(size=8, data=16, left=4080), 32: HEADER.format(size=4, data=12, left=4084)}
COMMON = """format:
\tfield:unsigned short common_type;\toffset:0;\tsize:2;\tsigned:0;
\tfield:unsigned char common_flags;\toffset:2;\tsize:1;\tsigned:0;
\tfield:unsigned char common_preempt_count;\toffset:3;\tsize:1;\tsigned:0;
\tfield:int common_pid;\toffset:4;\tsize:4;\tsigned:1;
"""
TAKE = f"""name: take_0_1
ID: 1500
{COMMON}
\tfield:unsigned long __probe_ip;\toffset:8;\tsize:8;\tsigned:0;
\tfield:s64 source_ns;\toffset:16;\tsize:8;\tsigned:1;
\tfield:u8 taken;\toffset:24;\tsize:1;\tsigned:0;
\tfield:__data_loc char[] topic;\toffset:25;\tsize:4;\tsigned:1;

print fmt: "(%lx)", REC->__probe_ip
"""
PRINT = f"""name: print
ID: 5
{COMMON}
\tfield:unsigned long ip;\toffset:8;\tsize:8;\tsigned:0;
\tfield:char buf[];\toffset:16;\tsize:0;\tsigned:0;
"""
PROBE = PlacedProbe(
    name="take_0_1", line="", event="take", constants={}, path="/x",
    arguments={"source_ns": "%dx:s64", "taken": "%cx:u8", "topic": "+0(%di):string"},
)  # fmt: skip


def take(number, topic=b"/a\0", tid=7):
    body = struct.pack("<HBBiQqBI", 1500, 0, 0, tid, 0, number, 1, (len(topic) << 16) | 29) + topic
    return body + bytes(-len(body) % 4)


def mark(text):
    body = struct.pack("<HBBiQ", 5, 0, 0, 7, 0) + f"rtrun {text}\n\0".encode()
    return body + bytes(-len(body) % 4)


def event(delta_ns, body):
    if len(body) <= 112:
        return struct.pack("<I", delta_ns << 5 | len(body) // 4) + body
    return struct.pack("<II", delta_ns << 5, len(body) + 4) + body


def page(begin_ns, data, *, flags=0, lost=b"", bits=64):
    commit = len(data) | flags
    if flags and bits == 64:
        # As the kernel adds it: a negative number.
        commit |= 0xFFFFFFFF << 32
    head = struct.pack("<QQ" if bits == 64 else "<QI", begin_ns, commit)
    return (head + data + lost).ljust(4096, b"\0")


def output(*rounds, end=b"rounds end\nrtrun end done\n"):
    head = f"rtrun observes\nheader_page\n{HEADERS[64]}rtrun end header_page\nplaced take_0_1\n"
    formats = {"rtrun_observe_1_2_3/take_0_1": TAKE, "ftrace/print": PRINT}
    described = "".join(f"format {name}/format\n{text}rtrun end format\n" for name, text in formats.items())
    return (head + described + "ready\n").encode() + b"".join(rounds) + end


def a_round(number, **pages):
    lines = [f"round {number}\nrealtime 100\n".encode()]
    for cpu, content in pages.items():
        lines.append(f"pages {cpu.removeprefix('cpu')}\n".encode() + content + b"rtrun end pages\n")
    return b"".join(lines)


BEGUN = event(0, mark("observes")) + event(10, mark("round 1")) + event(100, take(3))
RESTED = event(0, mark("rests")) + event(50, take(4)) + event(450, mark("observes")) + event(20, mark("round 3"))
ROUNDS = (
    a_round(1, cpu0=page(1000, BEGUN)),
    # Of this CPU an event comes that was before what the other has shown.
    a_round(
        2,
        cpu0=page(2000, event(0, mark("round 2"))),
        cpu1=page(990, event(0, take(0)) + event(60, take(1)) + event(50, take(2))),
    ),
    a_round(
        3,
        cpu1=page(3000, event(0, take(5)), flags=3 << 30, lost=struct.pack("<Q", 9)),
        cpu0=page(2500, RESTED),
    ),
)


# What else may be in it: a publication and a timer, of the same thread, and a switch of the kernel.
FIELD = "\tfield:{0} {1};\toffset:{2};\tsize:{3};\tsigned:{4};\n"
PUBLISH = f"name: publish_0_0\nID: 1501\n{COMMON}" + "".join(
    FIELD.format(*field)
    for field in (
        ("s64", "source_ns", 8, 8, 1),
        ("u64", "endpoint", 16, 8, 0),
        ("__data_loc char[]", "topic", 24, 4, 1),
    )
)
TIMER = f"name: timer_call_0_2\nID: 1502\n{COMMON}" + "".join(
    FIELD.format("s64", name, 8 + 8 * place, 8, 1)
    for place, name in enumerate(("timer", "period_ns", "expected_ns", "clock"))
)
SWITCH = f"name: sched_switch\nID: 300\n{COMMON}" + "".join(
    FIELD.format(*field)
    for field in (
        ("char", "prev_comm[16]", 8, 16, 0), ("pid_t", "prev_pid", 24, 4, 1), ("int", "prev_prio", 28, 4, 1),
        ("long", "prev_state", 32, 8, 1), ("char", "next_comm[16]", 40, 16, 0), ("pid_t", "next_pid", 56, 4, 1),
        ("int", "next_prio", 60, 4, 1),
    )
)  # fmt: skip
PROBES = {
    probe.name: probe
    for probe in (
        PROBE,
        replace(PROBE, name="publish_0_0", event="publish",
                arguments={"source_ns": "%dx:s64", "endpoint": "%di:u64", "topic": "+0(%di):string"}),
        replace(PROBE, name="timer_call_0_2", event="timer_call",
                arguments={"timer": "%di:s64", "period_ns": "%di:s64", "expected_ns": "%di:s64",
                           "clock": Named(number="%di:s64", names={3: "steady"})}),
    )
}  # fmt: skip


def _publish(number):
    return struct.pack("<HBBiqQI", 1501, 0, 0, 8, number, 5, (3 << 16) | 28) + b"/a\0\0"


def _timer(expected_ns):
    return struct.pack("<HBBiqqqq", 1502, 0, 0, 7, 9, 1_000_000, expected_ns, 3)


def switch():
    return struct.pack("<HBBi16siiq16sii", 300, 1, 0, 7, b"hog", 6, 50, 1, b"listener", 7, 120)


def watched():
    """The whole output of a call, in which a message is late."""
    formats = {"rtrun_observe_1_2_3/publish_0_0": PUBLISH, "rtrun_observe_1_2_3/timer_call_0_2": TIMER,
               "/events/sched/sched_switch": SWITCH}  # fmt: skip
    described = "".join(f"format {name}/format\n{text}rtrun end format\n" for name, text in formats.items())
    rounds = []
    for number in range(1, 5):
        at_ns = number * 1_000_000
        data = event(0, mark("observes")) if number == 1 else b""
        data += (
            event(10, mark(f"round {number}"))
            + event(5, _publish(number))
            + event(5, _timer(at_ns))
            + event(5, switch())
        )
        rounds.append(a_round(number, cpu0=page(at_ns, data + event(20_000 * number, take(number)))))
    program = (
        "programs\nprogram 70\nargument listener\nlocked 0 kB\n"
        f"stat 70 (listener) S{' 1' * 48}\ncpus 70 0-1\nmaps 7f00-7f01 08:01 5 /opt/ros/lib/libtracetools.so\n"
        "end 70\nrtrun end programs\nended 71\nlost 0 1 2\nrefused take_0_1 why\n"
    )
    text = output(*rounds, program.encode())
    return text.replace(b"ready\n", described.encode() + b"ready\n", 1)


def parse_programs(text: str, origin: str) -> FoundPrograms:
    """Read a whole listing of find_programs.sh, as it comes from a target line by line."""
    reader = ProgramReader(origin)
    for line in text.split("\n"):
        reader.take(line.encode("utf-8", "replace"))
    return reader.end()
