"""The suites built on a target, by its own compiler and for its own ROS: this machine, and one behind a real sshd."""

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from conftest import Sshd, seeing, serve
from ports import free_domain, free_port
from ros2 import wheels
from rtgen import suites as builder
from rtgen.cli import main as rtgen
from rtrun.cli import main
from rtrun.targets import local

pytestmark = [pytest.mark.ros, pytest.mark.sshd]

CAMPAIGN = """
schema: 1
name: built
common: {{policy: FIFO, frequency_hz: 50, repetitions: 100, domain_id: {domain}}}
runs:
  - {{suite: communication_tests, middleware: [roscpp, rcl, futex]}}
  - {{suite: cyclic_timer_tests, middleware: [roscpp, rcl]}}
"""


def target_file(folder: Path, sshd: Sshd | None = None, **keys: object) -> str:
    """Write the file of a target: this machine, or by its sshd; the path."""
    target: dict[str, object] = {"schema": 1, "name": "here", "kind": "local", "work_dir": str(folder / "work")}
    if sshd:
        reached = {"host": sshd.host, "port": sshd.port, "user": sshd.user, "key": str(sshd.key)}
        target |= {"kind": "ssh", "host_key": sshd.host_key, **reached}
    path = folder / "target.yml"
    path.write_text(json.dumps(target | {"ros_master_port": free_port()} | keys))
    return str(path)


@pytest.mark.root
@pytest.mark.xdist_group("suites built there")  # the second finds in ccache what the first compiled
@pytest.mark.parametrize("kind", ["local", "ssh"])
def test_built_there_and_measured(
    sshd: Sshd, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    prefix = wheels.installed("kilted")
    target = target_file(tmp_path, sshd if kind == "ssh" else None, ros_setup=f"{prefix}/setup.sh")
    assert rtgen(["suites", "build", "--on", target]) == 0
    built_with = dict(line.split(" ", 1) for line in capfd.readouterr().out.splitlines())
    assert {"compiler", "cmake", "flags", "sources", "roscpp", "rmw_fastrtps_cpp"} < set(built_with)
    assert (built_with["distro"], built_with["rcl"]) == ("kilted", version_of("rcl", prefix))
    assert [path.name for path in (tmp_path / "work/building").iterdir()] == ["lock"]
    monkeypatch.chdir(tmp_path)
    Path("campaign.yml").write_text(CAMPAIGN.format(domain=free_domain()))
    status = main(["run", "campaign.yml", "--target", target])
    records = [json.loads(path.read_text()) for path in Path("results/built").glob("*/run.json")]
    # A busy machine keeps a publisher from its rate, and the report says so.
    invalid = [record["reason"] for record in records if record["status"] != "ok"]
    assert all("_publisher: asked for 50 Hz, achieved " in reason for reason in invalid), invalid
    assert len(records) == 5 and status == (3 if invalid else 0)
    for record in records:
        assert record["target"]["suites_built_with"] == built_with
        assert all(program["argv"][0].startswith(f"{tmp_path}/work/built/") for program in record["programs"])
    capfd.readouterr()
    assert main(["report", "results/built", "--output", "report.html"]) == 0
    assert built_with["compiler"] in Path("report.html").read_text()


def version_of(package: str, prefix: Path) -> str:
    return (prefix / f"share/{package}/package.xml").read_text().split("<version>")[1].split("<")[0]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MiB."""
    folder = tmp_path / "work"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m,mode=755", "tmpfs", folder], check=True)
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def path_without(folder: Path, *names: str) -> str:
    """A folder with every program of this machine but these."""
    folder.mkdir()
    for path in [*Path("/usr/bin").iterdir(), *Path("/usr/sbin").iterdir()]:
        if path.name not in names and not (folder / path.name).is_symlink():
            (folder / path.name).symlink_to(path)
    return str(folder)


def refused(words: list[str], capsys: pytest.CaptureFixture[str], status: int = 3) -> str:
    """What `rtrun build-suites` says that cannot."""
    assert main(["build-suites", *words]) == status
    return capsys.readouterr().err


@pytest.mark.parametrize(
    "tools", [("c++", "g++"), ("cmake",), ("make", "ninja"), ("cmake", "ninja"), ("cc", "gcc", "c++", "cmake")]
)
def test_a_target_without_tools(
    tools: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(local, "PATH", path_without(tmp_path / "bin", *tools))
    refusal = refused([str(builder.sources()), "--target", target_file(tmp_path)], capsys)
    lacks = " ".join(tool for tool in tools if tool not in ("g++", "gcc", "ninja"))
    assert f"the target lacks {lacks}: install build-essential and cmake" in refusal


def test_a_target_without_ros(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none").mkdir()
    (tmp_path / "sshd").mkdir()
    with serve(tmp_path / "sshd", seeing({"/usr/share/roscpp": tmp_path / "none"})) as server:
        refusal = refused([str(builder.sources()), "--target", target_file(tmp_path, server)], capsys)
    assert "no ROS on the target: neither /opt/ros/*/setup.sh nor roscpp in /usr is there" in refusal


@pytest.mark.root
def test_a_target_whose_disk_is_full(tmp_path: Path, small_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refusal = refused([str(builder.sources()), "--target", target_file(tmp_path)], capsys)
    assert f"the target's disk is full (df -h {small_disk}/building" in refusal
    assert [path.name for path in (small_disk / "building").iterdir()] == ["lock"]


def plant_error(sources: Path) -> None:
    """In a file that is built after errors.cpp, whose name is no error."""
    with (sources / "rt_tests_support/src/trace.cpp").open("a") as stream:
        stream.write("int broken = missing_everywhere;\n")


def plant_cmake_error(sources: Path) -> None:
    (sources / "rt_tests_support/CMakeLists.txt").write_text("find_package(Nobodys REQUIRED)\n")


@pytest.mark.parametrize(
    ("plant", "expected"),
    [
        (plant_error, "trace.cpp:"),
        (plant_error, "error: ‘missing_everywhere’ was not declared in this scope"),
        (plant_cmake_error, "CMake Error at CMakeLists.txt:1 (find_package)"),
    ],
)
def test_sources_that_do_not_compile(
    plant: Callable[[Path], None], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was built before stays."""
    shutil.copytree(builder.sources(), tmp_path / "sources")
    (tmp_path / "work/built").mkdir(parents=True)
    (tmp_path / "work/.rt-tests").touch()
    (tmp_path / "work/built/built_with").write_text("compiler before\n")
    plant(tmp_path / "sources")
    refusal = refused([str(tmp_path / "sources"), "--target", target_file(tmp_path)], capsys)
    assert "the suites could not be built" in refusal and expected.replace("‘", "").replace("’", "") in refusal.replace(
        "'", ""
    )
    assert (tmp_path / "work/built/built_with").read_text() == "compiler before\n"


def test_what_cannot_be_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(builder.sources()), "--target"]
    (tmp_path / "suites").mkdir()
    (tmp_path / "suites/build.json").write_text("{}")
    refusal = refused([*words, target_file(tmp_path, suites="suites")], capsys, status=2)
    assert "names" in refusal and "leave that out" in refusal
    assert "has no build.sh" in refused([str(tmp_path), "--target", target_file(tmp_path)], capsys, status=2)
    for setup, wrong in {"/nowhere/setup.sh": "no such file", "/dev/null": "sets up no ROS"}.items():
        refusal = refused([*words, target_file(tmp_path, ros_setup=setup)], capsys)
        assert f"{setup}: {wrong}" in refusal or f"{setup} {wrong}" in refusal, refusal
    assert rtgen(["suites", "build", "--on", "target.yml", "--machine", "host"]) == 2
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/librcl.so").touch()
    (tmp_path / "setup.sh").write_text("echo a word; export AMENT_PREFIX_PATH=/\n")
    monkeypatch.setenv("ROS_VERSION", "2")
    capsys.readouterr()
    assert rtgen(["suites", "build", "--ros2", str(tmp_path)]) == 2
    assert "its setup.sh sets no ROS_VERSION: install its package ros_environment" in capsys.readouterr().err
