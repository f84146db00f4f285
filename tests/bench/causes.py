"""How long `rtrun why` reads the traces of 16 outliers, each with a copy of its own of 512 KiB a CPU.

`make bench` runs it; it is no test. The time is counted in that of a loop which matches a regular expression to each
line of the same files: it tells how fast the machine is at that moment.
"""

import re
import time
from pathlib import Path

from traced import head, line, switch, waking, write_traced_run

from rtrun.causes.outliers import explain_run
from rtrun.results.record import read_record

OUTLIERS, LINES = 16, 27_000  # about what two buffers of 512 KiB hold
STEP_US, VALUE_US = 11, 800
# Before pieces were passed over it was 6 to 12.
LOOPS_MAX = 4
PLAIN = re.compile(rb" *(.{1,32}?)-(\d+) +\[(\d+)\] +(\S+) +(\d+)\.(\d+): (\w+): (.*)")
ME, OTHER, IDLE = ("cyclic_timer_te", 1, 4), ("other", 2, 120), ("swapper/0", 0, 120)


def trace(index: int) -> str:
    """A trace whose CPUs switch between threads, with an outlier near its end."""
    begin_us = index * LINES * STEP_US
    lines = [head(VALUE_US, index, begin_us + (LINES // 6 - 40) * 6 * STEP_US + 20)]
    for number in range(LINES // 6):
        us = begin_us + number * 6 * STEP_US
        cpu = number % 2
        lines += [
            line(us, "local_timer_entry: vector=236", cpu=cpu, flags="d.h.."),
            waking(us + 3, 1, cpu=cpu, target=cpu, flags="d.h2."),
            line(us + 6, "local_timer_exit: vector=236", cpu=cpu, flags="d.h.."),
            switch(us + 9, IDLE, ME, state="R", cpu=cpu),
            line(us + 30, "page_fault_user: address=0x7f ip=0x55 error_code=0x6", cpu=cpu, name=ME[0], pid=1),
            switch(us + 40, ME, IDLE, cpu=cpu),
        ]
    return "".join(lines)


def test_sixteen_traces_of_512_kib_a_cpu(tmp_path: Path) -> None:
    folder = write_traced_run(tmp_path, {index: trace(index) for index in range(1, OUTLIERS + 1)}, [1])
    paths = sorted(folder.glob("*-trace-*.txt"))
    record = read_record(folder)
    taken_s, plain_s = [], []
    for _ in range(3):
        began = time.process_time()
        explained = list(explain_run(folder, record))
        taken_s.append(time.process_time() - began)
        began = time.process_time()
        for path in paths:
            with path.open("rb") as stream:
                for text in stream:
                    PLAIN.match(text)
        plain_s.append(time.process_time() - began)
        assert len(explained) == OUTLIERS and all(outlier.parts for outlier in explained)
    size = sum(path.stat().st_size for path in paths)
    ratio = min(taken_s) / min(plain_s)
    print(f"\n{OUTLIERS} traces, {size / 1e6:.0f} MB: {min(taken_s):.2f} s, {ratio:.1f} plain loops over their lines")
    assert ratio <= LOOPS_MAX
