"""The kernel built from the fragment: what comes out, that it boots on both machines, proves itself and measures."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

import rtrun.cli
from rtfiles import cache
from rtgen import kernel
from rtgen.cli import main
from rtgen.kconfig import data as kconfig

# A full build takes five minutes on two idle cores.
pytestmark = [pytest.mark.kernel, pytest.mark.timeout(3 * 3600)]

CAMPAIGN = """\
schema: 1
name: built
runs:
  - {suite: cyclic_timer_tests, policy: RR, frequency_hz: 100, repetitions: 50}
  - {suite: hwlatdetect, duration_s: 3}
"""

GOVERNOR = """\
schema: 1
name: governor
runs:
  - {suite: cyclic_timer_tests, policy: RR, frequency_hz: 100, repetitions: 300, governor: userspace}
"""

# QEMU's boards have one frequency; this is that one in the terms of cpufreq-dt, so that there are governors to choose.
ONE_FREQUENCY = """
/ {
    cpu_clock: cpu-clock { compatible = "fixed-clock"; #clock-cells = <0>; clock-frequency = <400000000>; };
    cpu_opps: opp-table {
        compatible = "operating-points-v2"; opp-shared;
        opp-400000000 { opp-hz = /bits/ 64 <400000000>; };
    };
    cpus {
        cpu@0 { clocks = <&cpu_clock>; operating-points-v2 = <&cpu_opps>; };
        cpu@1 { clocks = <&cpu_clock>; operating-points-v2 = <&cpu_opps>; };
    };
};
"""


@pytest.fixture(scope="module")
def built():
    data = kconfig.load()
    return kernel.build(data, "qemu-armv7", kernel.plan(data, "qemu-armv7"))


def test_what_is_built(built):
    record = json.loads((built / "kernel.json").read_text())
    assert re.fullmatch(r"6\.1\.\d+-rt\d+-rtgen", record["release"])
    assert sorted(path.name for path in (built / "dtbs").iterdir()) == [
        "omap4-panda-es-rt.dtb",
        "omap4-panda-es.dtb",
        "vexpress-v2p-ca9.dtb",
    ]
    assert sorted(record["dtbs"]) == sorted(path.name for path in (built / "dtbs").iterdir())
    # The magic number of a zImage (Documentation/arm/booting.rst) stands at byte 36.
    assert (built / "vmlinuz").read_bytes()[36:40] == (0x016F2818).to_bytes(4, "little")
    assert (built / "modules" / record["release"] / "modules.dep").is_file()
    assert {path.name for path in built.iterdir()} == {"config", "dtbs", "kernel.json", "modules", "vmlinuz"}


def test_the_panda_gets_a_fine_clock(built):
    def source(name):
        dtb = built / "dtbs" / name
        return subprocess.run(
            ["dtc", "-q", "-I", "dtb", "-O", "dts", dtb], check=True, capture_output=True, text=True
        ).stdout

    plain, changed = source("omap4-panda-es.dtb"), source("omap4-panda-es-rt.dtb")
    assert "always-on" not in re.search(r"local-timer@48240600 \{.*?\};", plain, re.S)[0]
    assert "always-on" in re.search(r"local-timer@48240600 \{.*?\};", changed, re.S)[0]
    assert 'status = "disabled"' in re.search(r"counter@0 \{.*?\};", changed, re.S)[0]


def test_a_second_build_builds_nothing(built, monkeypatch):
    monkeypatch.setattr(kernel.debian_source, "unpack", lambda *_, **__: pytest.fail("it builds again"))
    data = kconfig.load()
    assert kernel.build(data, "qemu-armv7", kernel.plan(data, "qemu-armv7")) == built


def test_an_interrupted_build_leaves_nothing(built, tmp_path):
    # The sources are there already; only the build is to start from nothing.
    for kind in ("kernel-source", "kernel-kconfig", "kconfig-tree"):
        (tmp_path / kind).symlink_to(cache.root() / kind)
    environment = os.environ | {"META_RT_TESTS_CACHE": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-m", "rtgen.cli", "kernel", "build", "--machine", "qemu-armv7"],
        env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    # While the source is unpacked: a whole tree takes long to make, and to remove again.
    while process.poll() is None and not list(tmp_path.glob("kernel-built/.*/linux/*")):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=1800)
    assert (process.returncode, error) == (130, "rtgen: interrupted\n")
    assert [path.name for path in (tmp_path / "kernel-built").iterdir() if not path.name.endswith(".lock")] == []


@pytest.mark.qemu
@pytest.mark.parametrize(("machine", "clockevent"), [("qemu-armv7", "arch_sys_timer"), ("vexpress-a9", "local_timer")])
def test_it_boots_proves_itself_and_measures(built, machine, clockevent, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["board", "build", "--machine", machine, "--kernel", "built"]) == 0
    assert main(["suites", "build", "--machine", "qemu-armv7"]) == 0
    target = tmp_path / "target.yml"
    target.write_text(
        f"schema: 1\nname: {machine}\nkind: qemu\nboard: build/board/{machine}\nsuites: build/suites/qemu-armv7\n"
    )
    saved = tmp_path / "config.gz"
    capsys.readouterr()
    rtrun.cli.main(["check-rt", "--target", str(target), "--json", "--save-config", str(saved)])
    printed = json.loads(capsys.readouterr().out)
    release = json.loads((built / "kernel.json").read_text())["release"]
    assert printed["kernel"].startswith(f"{release} ") and " PREEMPT_RT " in printed["kernel"]
    assert printed["platform"] == "emulated" and printed["ready"] is True
    assert any(line.endswith(clockevent) for line in printed["clockevent"])
    checks = {check["name"]: check["status"] for check in printed["checks"]}
    assert (checks["PREEMPT_RT"], checks["real-time scheduling"], checks["high-resolution timers"]) == (
        "ok",
        "ok",
        "ok",
    )

    assert main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(saved)]) == 0

    (tmp_path / "built.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "built.yml", "--target", str(target)]) == 0
    folders = sorted(path.parent for path in (tmp_path / "results/built").glob("*/run.json"))
    record, hwlat = [json.loads((folder / "run.json").read_text()) for folder in folders]
    assert (record["status"], record["platform"], record["target"]["preempt_rt"]) == ("ok", "emulated", True)
    # The fragment has the tracer that Debian's kernel has not.
    assert (hwlat["suite"], hwlat["status"]) == ("hwlatdetect", "ok")
    assert "test duration 3 seconds" in (folders[1] / "hwlatdetect.stdout").read_text()
    assert record["target"]["kernel_release"] == release
    assert record["target"]["clock"]["source"] == record["target"]["clocksource"]
    assert 0 < record["target"]["clock"]["step_ns"] < 1_000_000
    packed = next((tmp_path / "results/built").glob("*/kernel.config.gz"))
    assert main(["kconfig", "verify", "--machine", "qemu-armv7", "--config", str(packed)]) == 0


@pytest.mark.qemu
def test_a_governor_is_held_where_the_kernel_has_them(built, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["board", "build", "--machine", "qemu-armv7", "--kernel", "built"]) == 0
    assert main(["suites", "build", "--machine", "qemu-armv7"]) == 0
    board = tmp_path / "board"
    board.mkdir()
    for path in (tmp_path / "build" / "board" / "qemu-armv7").iterdir():
        (board / path.name).symlink_to(path.resolve())
    described = json.loads((board / "board.json").read_text())
    dump = ["-nodefaults", "-display", "none", "-machine", "dumpdtb=plain.dtb"]
    qemu = [described["qemu"]["binary"], *described["qemu"]["arguments"], *dump]
    subprocess.run(qemu, check=True, capture_output=True)
    dtc = ["dtc", "-q", "-I"]
    source = subprocess.run([*dtc, "dtb", "-O", "dts", "plain.dtb"], check=True, capture_output=True, text=True).stdout
    subprocess.run([*dtc, "dts", "-O", "dtb", "-o", board / "dtb"], input=source + ONE_FREQUENCY, check=True, text=True)
    (board / "board.json").unlink()
    (board / "board.json").write_text(json.dumps(described | {"dtb": "dtb"}))
    target = tmp_path / "target.yml"
    target.write_text("schema: 1\nname: board\nkind: qemu\nboard: board\nsuites: build/suites/qemu-armv7\n")
    (tmp_path / "governor.yml").write_text(GOVERNOR)
    assert rtrun.cli.main(["run", "governor.yml", "--target", str(target)]) == 0
    (folder,) = [path.parent for path in (tmp_path / "results/governor").glob("*/run.json")]
    record = json.loads((folder / "run.json").read_text())
    assert (record["status"], record["requested"]["governor"]) == ("ok", "userspace")
    assert record["in_effect"]["governor"] == ["userspace"]
    assert record["in_effect"]["frequency_khz"] == [400000, 400000]
    states = json.loads((folder / "target.json").read_text())
    put_back = ["performance", "performance"]
    assert states["before"]["governor"] == states["after"]["governor"] == put_back
