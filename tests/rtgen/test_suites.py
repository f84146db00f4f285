"""The build of the suites: order, cache, record, errors; natively and for ARM, with the real tools."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ros2 import wheels
from rtfiles.errors import InfrastructureError, UsageError
from rtgen import cli, debian, suites
from rtgen.board import sysroot
from rtgen.checkout import checkout

ELF_MACHINE = 18  # offset of e_machine
EM_ARM = 40


def test_support_comes_first() -> None:
    assert suites.packages() == [
        "rt_tests_support",
        "rt_tests_sampler",
        "oneshot_timer_tests",
        "cyclic_timer_tests",
        "communication_tests",
        "topology_tests",
        "transport_tests",
    ]


def test_every_package_is_built() -> None:
    folders = {path.parent.name for path in suites.sources().glob("*/package.xml")}
    assert folders == set(suites.packages())


def test_unknown_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UsageError, match=r"unknown machine 'vax', known: host, "):
        suites.build("vax", tmp_path)
    assert cli.main(["suites", "build", "--machine", "vax"]) == 2
    assert capsys.readouterr().err.startswith("rtgen: unknown machine 'vax'")


def test_this_machine_has_the_libraries_that_it_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["suites", "build", "--suite", "trixie"]) == 2
    expected = "rtgen: --suite trixie is for boards: host has the libraries that are installed on it\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize(
    ("suite", "expected"), [("bookworm", ""), ("trixie", " -D_FILE_OFFSET_BITS=64 -D_TIME_BITS=64")]
)
def test_programs_have_the_time_of_their_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suite: str, expected: str
) -> None:
    monkeypatch.setattr(sysroot, "build", lambda architecture, source: tmp_path / architecture / source.release)
    tools = suites.toolchain("qemu-armv7", suite)
    assert tools.flags == f"{suites.FLAGS}{expected}"
    assert (tools.release, tools.sysroot) == (suite, tmp_path / "armhf" / suite)
    # What generates code for a transport runs here: it is built again once that is installed.
    assert any(line.startswith("cyclonedds-tools\t") for line in tools.identity)


@pytest.mark.parametrize("machine", ["host", "qemu-armv7"])
def test_build(tmp_path: Path, machine: str) -> None:
    link = suites.build(machine, tmp_path)
    assert link == tmp_path / machine
    record = json.loads((link / "build.json").read_text())
    assert (record["schema"], record["machine"]) == (1, machine)
    assert ("arm-linux-gnueabihf" in record["compiler"]) == (machine != "host")
    assert record["debian"] == (None if machine == "host" else debian.source().release)
    described = suites.describe(link)
    described.pop("build.json")
    assert record["files"] == described
    programs = sorted(path for path in described if path.startswith("lib/"))
    messages = ["communication_tests_publisher", "communication_tests_subscriber"]
    assert programs == [
        *(f"lib/communication_tests/{program}" for program in messages),
        "lib/cyclic_timer_tests/cyclic_timer_tests",
        "lib/oneshot_timer_tests/oneshot_timer_tests",
        "lib/rt_tests_sampler/rt_tests_allocations.so",
        "lib/rt_tests_sampler/rt_tests_sampler",
        "lib/topology_tests/topology_node",
        *(f"lib/transport_tests/{program}_{transport}" for program in messages for transport in suites.transports()),
        "lib/transport_tests/topology_node_cyclonedds",
    ]
    timers = ["oneshot_timer_tests", "cyclic_timer_tests"]
    assert record["middlewares"] == dict.fromkeys(suites.transports(), messages) | {"roscpp": [*timers, *messages]}
    assert record["not_built"] == {}
    for program in programs:
        is_arm = int.from_bytes((link / program).read_bytes()[ELF_MACHINE : ELF_MACHINE + 2], "little") == EM_ARM
        assert is_arm == (machine != "host")
    assert sorted(path.name for path in link.glob("share/*/launch/*")) == [
        "communication_tests.launch",
        "communication_tests_5sub.launch",
        "control.topology",
        "cyclic_timer_tests.launch",
        "oneshot_timer_tests.launch",
        "sensing.topology",
        "topology_tests.launch",
    ]
    assert (link / "suites.yml").read_bytes() == (suites.sources() / "suites.yml").read_bytes()


def test_a_transport_whose_packages_are_missing_is_not_built_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "recipes-tests"
    shutil.copytree(suites.sources(), copy)
    fragment = copy / "transport_tests/zeromq/transport.cmake"
    fragment.write_text(
        fragment.read_text().replace("zmq", "no_such_library").replace("libno_such_library3", "libzmq3")
    )
    monkeypatch.setattr(suites, "sources", lambda: copy)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["suites", "build"]) == 0
    assert "\nzeromq is not among them: it needs libzmq3-dev\n" in capsys.readouterr().err
    record = json.loads(Path("build/suites/host/build.json").read_text())
    assert set(record["middlewares"]) == {"roscpp", *suites.transports()} - {"zeromq"}
    assert record["not_built"] == {"zeromq": ["libzmq3-dev"]}


def test_this_machine_is_set_up_with_the_packages_of_all_transports() -> None:
    lists = [checkout() / f"tools/apt-packages{name}.txt" for name in ("-quick", "", "-all")]
    listed = {package for path in lists for package in path.read_text().split()}
    assert {package for packages in suites.transports().values() for package in packages} <= listed


def test_second_build_is_the_same_and_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = suites.build("host", tmp_path).readlink()
    monkeypatch.setattr(suites, "build_package", None)
    assert suites.build("host", tmp_path).readlink() == first


def test_what_was_built_is_for_every_user_and_replaces_what_was_built_before(tmp_path: Path) -> None:
    """The cache is in the home folder of who builds, often root's."""
    for name in (f".host-{'0' * 16}", f".host-arm-{'0' * 16}"):
        (tmp_path / name).mkdir()
    folder = suites.build("host", tmp_path).resolve()
    assert folder.parent == tmp_path and (folder / "build.json").is_file()
    assert all(path.stat().st_mode & 0o004 for path in (folder, *folder.rglob("*")))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([f".host-arm-{'0' * 16}", folder.name, "host"])


def test_two_builds_at_once_leave_one(tmp_path: Path) -> None:
    """Both wait for the same entry of the cache, and copy it at the same moment."""
    for _ in range(10):
        with ThreadPoolExecutor(4) as builders:
            folders = list(builders.map(lambda _: suites.build("host", tmp_path / "suites"), range(4)))
        assert set(folders) == {tmp_path / "suites/host"} and (folders[0] / "build.json").is_file()
        shutil.rmtree(tmp_path / "suites")


@pytest.mark.ros
def test_a_ros2_is_built_for_with_a_ros_1_and_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = wheels.installed("kilted")
    both = suites.build("host", tmp_path / "both", ros2=prefix)
    monkeypatch.setattr(suites, "HOST_PACKAGES", ("no-package-of-this-name",))
    with pytest.raises(InfrastructureError, match="tools/setup all"):
        suites.build("host", tmp_path)
    alone = suites.build("host", tmp_path / "alone", ros2=prefix)
    records = {folder: json.loads((folder / "build.json").read_text()) for folder in (both, alone)}
    programs = records[both]["middlewares"]
    assert len(programs["rcl"]) == 4 and sorted(programs["rcl"]) == sorted(programs["roscpp"])
    assert records[alone]["middlewares"] == {name: those for name, those in programs.items() if name != "roscpp"}
    for folder, record in records.items():
        assert set(record["ros2"]) == {"prefix", "distro", "rcl", "rmw_fastrtps_cpp"}
        assert (record["ros2"]["prefix"], record["ros2"]["distro"]) == (str(prefix), "kilted")
        assert set(record["files"]) == {
            str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file() and path.name != "build.json"
        }


def test_no_ros2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["suites", "build", "--ros2", str(tmp_path)]) == 2
    expected = f"rtgen: --ros2 {tmp_path}: has no setup.sh: give the folder of a ROS 2, as /opt/ros/jazzy\n"
    assert capsys.readouterr().err == expected
    assert cli.main(["suites", "build", "--machine", "qemu-armv7", "--ros2", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"rtgen: --ros2 {tmp_path} is of this machine: build for host, or ")


def test_a_change_is_built_and_a_mistake_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = tmp_path / "recipes-tests"
    shutil.copytree(suites.sources(), copy)
    monkeypatch.setattr(suites, "sources", lambda: copy)
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "cache"))
    (copy / "rt_tests_support" / "src" / "json.cpp").write_text("this is no C++\n")
    with pytest.raises(InfrastructureError, match=r"(?s)exit status 1 of ninja .*json.cpp:1:1: error"):
        suites.build("host", tmp_path / "place")
    assert not (tmp_path / "place").exists()
    remaining = [path for path in (tmp_path / "cache" / "suites").iterdir() if path.suffix != ".lock"]
    assert remaining == []
