"""The suites, compiled by the compilers of Yocto's releases against both versions of ROS, run on the emulated board.

Not part of `make test`: `make test-compilers` runs it. kirkstone has gcc 11, scarthgap 13, wrynose 15. Debian has them
as cross compilers, each in another of its releases: they are unpacked, not installed, and run with their own libraries.
"""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

import rtgen.cli
import rtgen.suites
import rtrun.cli
from rtfiles import cache
from rtgen import debian

pytestmark = [pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(1800)]

TRIPLET = "arm-linux-gnueabihf"
# The release of Debian that has a version of gcc.
RELEASES = {"11": "bookworm", "13": "trixie", "14": "trixie", "15": "forky"}
ROSCPP = {"bookworm": "1.15.", "trixie": "1.17."}
CAMPAIGN = """schema: 1
name: compilers
common: {repetitions: 50, policy: RR}
runs:
  - {suite: oneshot_timer_tests}
  - {suite: cyclic_timer_tests, frequency_hz: 50}
  - {suite: communication_tests, frequency_hz: 50}
"""
TARGET = """schema: 1
name: qemu-armv7
kind: qemu
board: build/board/qemu-armv7
suites: build/suites/qemu-armv7
"""


def compiler(version: str) -> Path:
    """A folder with gcc and g++ of this version under the names of Debian's default ones; cached or downloaded."""
    source = debian.source(RELEASES[version])
    # The index of a release in preparation expires after days, which a mirror that stands still outlives.
    source = dataclasses.replace(source, mirror=source.mirror and f"[check-valid-until=no] {source.mirror}")

    def build(folder: Path) -> None:
        debian.extract([f"g++-{version}-{TRIPLET}"], folder, "amd64", source)
        # The C library is that of the sysroot; the compiler brings the headers of its C++ library alone.
        shutil.rmtree(folder / "usr" / TRIPLET / "lib")
        for path in (folder / "usr" / TRIPLET / "include").iterdir():
            if path.is_dir() and path.name != "c++":
                shutil.rmtree(path)
            elif not path.is_dir():
                path.unlink()
        add_programs(version, folder)

    return cache.entry("compiler", cache.digest([version, repr(source), Path(__file__)]), build) / "programs"


def add_programs(version: str, folder: Path) -> None:
    """Scripts that run the unpacked compiler, with the loader and libraries of its release, wherever the folder is."""
    # gcc starts its parts by -wrapper; collect2, one of them, starts the linker by itself, which it finds by -B.
    scripts = {"parts/ld": '"$program"-ld "$@"'}
    for name in ("gcc", "g++"):
        options = '-wrapper "$loader,--library-path,$libraries" -B "${0%/*}/parts"'
        scripts[f"{TRIPLET}-{name}"] = f'"$program"-{name}-{version} {options} "$@"'
    (folder / "programs/parts").mkdir(parents=True)
    for name, command in scripts.items():
        up = "../.." if "/" in name else ".."
        path = folder / "programs" / name
        path.write_text(
            f"""#!/bin/sh
tree=${{0%/*}}/{up}
loader=$tree/lib64/ld-linux-x86-64.so.2
libraries=$tree/lib/x86_64-linux-gnu:$tree/usr/lib/x86_64-linux-gnu
program=$tree/usr/bin/{TRIPLET}
exec "$loader" --library-path "$libraries" {command}
"""
        )
        path.chmod(0o755)


@pytest.mark.parametrize("suite", ROSCPP)
@pytest.mark.parametrize("version", RELEASES)
def test_suites_compile_without_a_warning_and_measure(version, suite, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(compiler(version)), prepend=":")
    monkeypatch.setattr(rtgen.suites, "FLAGS", f"{rtgen.suites.FLAGS} -Werror")
    monkeypatch.chdir(tmp_path)
    options = ["--machine", "qemu-armv7", "--suite", suite]
    assert rtgen.cli.main(["suites", "build", *options]) == 0
    record = json.loads(Path("build/suites/qemu-armv7/build.json").read_text())
    assert record["compiler"].rpartition(" ")[2].startswith(f"{version}.")
    assert rtgen.cli.main(["board", "build", *options]) == 0
    Path("target.yml").write_text(TARGET)
    Path("campaign.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "campaign.yml", "--target", "target.yml"]) == 0
    runs = [path.parent for path in Path("results/compilers").glob("*/run.json")]
    records = [json.loads((run / "run.json").read_text()) for run in runs]
    assert [record["status"] for record in records] == ["ok"] * 3
    for record in records:
        assert record["target"]["middleware_version"].startswith(ROSCPP[suite])
