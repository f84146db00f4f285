"""A target that lies while its programs are observed: the runner ends in time, and within its memory."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from measured import measured

LIAR = Path(__file__).with_name("lying_observer.py")
HOUR = Path(__file__).with_name("hour.py")
MEMORY_MAX_KIB = 300 * 1024
# The runner's own memory since it began to run: that of a child holds what the process had that started it.
OBSERVE = """
import sys
from datetime import datetime
from pathlib import Path, PosixPath, PurePosixPath
from rtrun.execution import observation
from rtrun.flows.streams import streams
from rtrun.plan.observation import ObservationPlan
from rtrun.probes import session
from rtrun.probes.placement import Placement, PlacedProbe
from rtrun.results import texts
from rtrun.targets.address import ThisMachine
from rtrun.targets.config import Target
from rtrun.targets.link import Link
texts.TEXT_BYTES_MAX = 2**24  # in a file; to make it all would take half a minute
session.SET_UP_S = 5.0
session.END_S = 2.0
session.TAKE_OFF_S = 1.0
target = Target(name="t", address=ThisMachine(), suites=None, work_dir=PurePosixPath("/x"), setup=None, master_port=1,
                reconnect_s=0, boot_s=0, console=None, failure=lambda: None)
message = {"endpoint": "%di:u64", "source_ns": "%dx:s64", "topic": "+0(%si):string"}
probes = tuple(PlacedProbe(name=name, line="", event=name[:-4], arguments=arguments, constants={}, path="/x")
               for name, arguments in {"publish_0_0": message, "take_0_1": message,
                                       "callback_begin_0_2": {"callback": "%di:u64"}}.items())
watched = observation.Watched(found=(), placement=Placement(probes=probes, refused=()))
with Link(target, print) as link:
    try:
        seen = observation.observe(link, PurePosixPath(sys.argv[1]), watched, ObservationPlan(for_s=3.0),
                                   trace=sys.argv[2], onlooker=observation.Onlooker(), now=datetime.now)
        print("streams", sum(1 for _ in streams(seen.flows)), seen.remarks)
    except Exception as error:
        print("error", type(error).__name__, error)
print(next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")))
"""
LIES = (
    "hits", "topics", "endpoints", "texts", "pages", "threads", "callbacks", "stamps", "still", "placed", "rounds",
    "programs", "a program", "gaps", "one round", "one text",
    "cpu sets", "clock", "clock that jumps", "traces", "no line", "errors", "silence", "drip", "ready again", "late",
)  # fmt: skip

CLOCK = "what watch_probes.sh printed cannot be read: a page that claims .* ns on"
ENDS = {
    "no line": "^error TargetError .*a line without an end",
    "errors": "^error TargetError .*printed more than 2 MiB",
    "ready again": "^streams 0 .*unexpected line 'ready'",
    "clock": f"^error TargetError .*{CLOCK}",
    "clock that jumps": f"^streams 1 .*'it was ended early: this machine: {CLOCK}",
}


@pytest.mark.timeout(150)
@pytest.mark.parametrize("lie", LIES)
def test_a_target_that_lies(lie, tmp_path):
    script = tmp_path / "watch_probes.sh"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} {LIAR} '{lie}'\n")
    script.chmod(0o755)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    argv = [sys.executable, "-c", OBSERVE, str(tmp_path), "0us" if lie == "traces" else ""]
    # What waits for no end is far below this, on a busy machine as well.
    ended = subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=120, check=True)
    match = re.search(r"^VmHWM:\s+(\d+) kB$", ended.stdout, re.M)
    assert match and int(match[1]) < MEMORY_MAX_KIB, ended.stdout
    assert re.search(ENDS.get(lie, "^(error TargetError|streams) "), ended.stdout, re.M), ended.stdout


def test_an_hour_that_is_honest(tmp_path):
    """Its memory does not grow with its messages: so many took 260 MiB, and an hour of them 8 GiB."""
    ended = measured([sys.executable, HOUR, 1_000_000, tmp_path], timeout_s=120, check=False)
    assert ended.status == 0, ended.stderr
    assert ended.peak_mib < 160
    samples = {path.parent.name: np.load(path, mmap_mode="r") for path in (tmp_path / "results").rglob("*.npy")}
    assert {len(rows) for rows in samples.values()} == {999_999} and len(samples) == 5
    (messages,) = (rows for name, rows in samples.items() if "messages" in name)
    assert np.array_equal(messages[:, 2], np.arange(999_999))
