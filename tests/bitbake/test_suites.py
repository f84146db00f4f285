"""The tasks of the suites' recipes, run by the real BitBake with Debian's cross compiler and ROS sysroot.

What they install for one release measures on the emulated board.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

import rtgen.cli
import rtgen.suites
import rtrun.cli
from ros2 import wheels
from rtgen import debian
from rtgen.board import sysroot
from rtgen.checkout import checkout
from rtgen.commands import DEFAULT_PROFILE
from rtgen.layer.recipes import recipes_of
from rtgen.profile import load_profile

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(1200)]

TASKS = ("do_fetch", "do_unpack", "do_configure", "do_compile", "do_install")
TOOLCHAIN = Path(rtgen.suites.__file__).with_name("debian.cmake")
PROGRAMS = {
    "oneshot-timer-tests": ["oneshot_timer_tests"],
    "cyclic-timer-tests": ["cyclic_timer_tests"],
    "communication-tests": ["communication_tests_publisher", "communication_tests_subscriber"],
    "topology-tests": ["topology_node"],
}
ARM = ("32-bit", "ARM", "EABI5")  # words of file(1)
WITHOUT_A_LIBRARY = ["futex", "tcp", "udp", "unix"]


def tools() -> str:
    return (
        f'SYSROOT = "{sysroot.build("armhf", debian.source())}"\nTOOLCHAIN_FILE = "{TOOLCHAIN}"\n'
        f'BUILD_PYTHON = "{rtgen.suites.SYSTEM_PYTHON}"\n'
        f'export ROS_LANG_DISABLE = "{rtgen.suites.ROS_LANG_DISABLE}"\n'
    )


def tasks(*recipes: str) -> list[list[str]]:
    return [[recipe, task] for recipe in recipes for task in TASKS]


def build_suites(make_build, name, machine, local, clients, kind):
    """Build the suites of a profile for a machine, check what is installed, and return the build.

    `clients`: what the names of the suites' programs end with. `kind`: words of file(1) about each program.
    """
    build = make_build(name, machine, local=local)
    profile, release = load_profile(name)
    ros = release.ros_distros[profile.ros_distro]
    prefix = f"/opt/ros/{profile.ros_distro}" if ros.version else "/usr"
    of_ros = PROGRAMS if ros.version else {}
    files = build.bitbake(tasks=tasks(*(suite.name for suite in recipes_of(profile, release))))["files"]
    transports = [f"_{name}" for name in [*WITHOUT_A_LIBRARY, *ros.transports]]
    wanted = {suite: [program + client for program in of_ros[suite] for client in clients] for suite in of_ros}
    wanted["transport-tests"] = [program + name for program in PROGRAMS["communication-tests"] for name in transports]
    wanted["rt-tests-sampler"] = ["rt_tests_allocations.so", "rt_tests_sampler"]
    for suite, programs in wanted.items():
        package = suite.replace("-", "_")
        installed = {
            path for path, owner in files[suite].items() if path.startswith(f"{prefix}/lib/") and owner == suite
        }
        assert installed == {f"{prefix}/lib/{package}/{program}" for program in programs}
        for path in installed:
            binary = next(build.folder.glob(f"tmp/work/{suite}/*/image{path}"))
            printed = subprocess.run(["file", "-b", binary], capture_output=True, text=True, check=True).stdout
            assert all(word in printed for word in ("ELF", *kind)), printed
        assert files[suite][f"{prefix}/share/{package}/package.xml"] == suite
    for of_suite in files.values():
        assert [path for path, package in of_suite.items() if not package] == []
    library = [path for path, package in files["rt-tests-support"].items() if package == "rt-tests-support"]
    assert not [path for path in library if path.endswith((".a", ".h", ".so"))]
    assert files["rt-tests-support"][f"{prefix}/lib/librt_tests_support.a"] == "rt-tests-support-staticdev"
    for suite in of_ros:
        launch = [path for path in files[suite] if path.endswith(".launch")]
        assert bool(launch) == (clients == [""]) and all(files[suite][path] == suite for path in launch)
    return build


def test_fetch_to_install(make_build):
    """Of wrynose, which unpacks into UNPACKDIR; scarthgap, below, unpacks into WORKDIR as kirkstone does."""
    build_suites(make_build, "wrynose-noetic", "pandaboard-es", tools(), [""], ARM)


def test_without_ros(make_build):
    """What is installed is where the runner looks, and belongs to a package."""
    build = build_suites(make_build, "scarthgap-base", "qemuarm", tools(), [], ARM)
    lib = build.folder / "tmp/stage/usr/lib"
    script = (Path(rtrun.__file__).parent / "on_target/inspect.sh").read_text()
    assert " /usr/lib;" in script
    script = script.replace(" /usr/lib;", f" {lib};")
    command = ["sh", "-s", str(build.folder), ""]
    printed = subprocess.run(command, input=script, stdout=subprocess.PIPE, text=True, check=True).stdout
    found = {Path(line.removeprefix("program ")).name for line in printed.splitlines() if line.startswith("program ")}
    assert found == {"rt_tests_sampler", *(path.name for path in (lib / "transport_tests").iterdir())}
    assert len(found) > 2 * len(WITHOUT_A_LIBRARY)


def tools_of_this_machine(prefix):
    """Lines for local.conf: this machine's compiler and a ROS 2 instead of a board's; the wheels have no rclcpp."""
    return (
        f'stub_setup = ". {prefix}/setup.sh"\nstub_compiler = "-DPython3_EXECUTABLE={rtgen.suites.SYSTEM_PYTHON}"\n'
        "EXTRA_OECMAKE:remove = \"-DCMAKE_REQUIRE_FIND_PACKAGE_rclcpp='ON'\"\n"
    )


@pytest.mark.ros
def test_on_ros_2(make_build):
    """What is installed is where the runner looks. A recipe does without no client library."""
    local = tools_of_this_machine(wheels.installed("kilted"))
    build = build_suites(make_build, "wrynose-lyrical", "qemux86-64", local, ["_rcl"], ("x86-64",))
    stage = build.folder / "tmp/stage/opt/ros/lyrical"
    script = f". {Path(rtrun.__file__).parent}/on_target/middleware/rcl.sh"
    environment = os.environ | {"ros_setup": str(stage / "setup.sh")}
    printed = subprocess.run(
        ["sh", "-c", script], env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout
    names = [f"{program}_rcl" for programs in PROGRAMS.values() for program in programs] + ["rt_tests_sampler"]
    assert sorted(Path(line.removeprefix("program ")).name for line in printed.splitlines()) == sorted(names)

    conf = build.folder / "conf/local.conf"
    conf.write_text(conf.read_text().replace("EXTRA_OECMAKE:remove", "UNUSED"))
    done = build.try_bitbake(tasks=tasks("cyclic-timer-tests"))
    assert done.returncode != 0 and "rclcpp" in done.stderr


CAMPAIGN = """schema: 1
name: recipes
common: {repetitions: 20, policy: RR}
runs:
  - {suite: oneshot_timer_tests}
  - {suite: cyclic_timer_tests, frequency_hz: 50}
  - {suite: communication_tests, frequency_hz: 50, middleware: [roscpp, zeromq]}
"""


@pytest.mark.qemu
@pytest.mark.ros
def test_programs_of_the_recipes_measure_on_the_board(make_build, tmp_path, monkeypatch):
    build = build_suites(make_build, DEFAULT_PROFILE, "qemuarm", tools(), [""], ARM)
    suites = tmp_path / "suites"
    suites.mkdir()
    rtgen.suites.collect(build.folder / "tmp" / "stage" / "opt" / "ros" / "noetic", suites)
    shutil.copyfile(checkout() / "recipes-tests" / "suites.yml", suites / "suites.yml")
    (suites / "build.json").write_text(json.dumps({"schema": 1, "machine": "qemu-armv7"}))

    monkeypatch.chdir(tmp_path)
    assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    (tmp_path / "target.yml").write_text(
        "schema: 1\nname: qemu-armv7\nkind: qemu\nboard: build/board/qemu-armv7\nsuites: suites\n"
    )
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "campaign.yml", "--target", "target.yml"]) == 0
    records = [json.loads(path.read_text()) for path in (tmp_path / "results" / "recipes").glob("*/run.json")]
    assert len(records) == 4
    assert {record["status"] for record in records} == {"ok"}


def test_layer_works_outside_the_repository(make_build):
    """Only meta-rt-tests/ and recipes-tests/ side by side, as another kas project would have them."""
    build = make_build("scarthgap-noetic", "qemuarm", local=tools())
    shutil.rmtree(build.layer)
    (build.layer.parent / "recipes-tests").unlink()
    shutil.copytree(checkout() / "meta-rt-tests", build.layer, symlinks=True)
    shutil.copytree(checkout() / "recipes-tests", build.layer.parent / "recipes-tests")
    answer = build.bitbake(tasks=tasks("rt-tests-support")[:2])
    assert answer["recipes"]["oneshot-timer-tests"]["skipped"] is None
    assert next(build.folder.glob("tmp/work/rt-tests-support/*/rt_tests_support/package.xml")).is_file()
    assert (build.layer / "recipes-tests/suites/files").resolve() == build.layer.parent / "recipes-tests"


def test_a_source_that_does_not_compile_fails_the_task(make_build):
    build = make_build("scarthgap-noetic", "qemuarm", local=tools())
    link = build.layer / "recipes-tests/suites/files"
    sources = link.resolve()
    link.unlink()
    shutil.copytree(sources, link)
    code = next((link / "rt_tests_support/src").glob("*.cpp"))
    code.write_text(code.read_text() + "\n#error broken on purpose\n")
    done = build.try_bitbake(tasks=tasks("rt-tests-support"))
    assert done.returncode != 0
    assert "broken on purpose" in done.stderr
