"""The suites in a workspace of catkin, as docs/targets.md has it for a board that builds them itself."""

import shutil
from pathlib import Path

import pytest

from rtgen import suites as builder

from .conftest import PROGRAMS, output_of


def test_catkin_make_builds_and_installs_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(builder.sources(), tmp_path / "src")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_LANG_DISABLE", builder.ROS_LANG_DISABLE)
    launcher = ["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else []
    monkeypatch.setenv("CCACHE_BASEDIR", str(tmp_path))
    monkeypatch.setenv("CCACHE_NOHASHDIR", "1")
    options = [
        "-DCMAKE_CXX_FLAGS=-O2",
        "-DCATKIN_BUILD_BINARY_PACKAGE=1",
        f"-DCMAKE_INSTALL_PREFIX={tmp_path}/ros",
        f"-DPYTHON_EXECUTABLE={builder.SYSTEM_PYTHON}",
    ]
    output_of(builder.SYSTEM_PYTHON, str(shutil.which("catkin_make")), "-C", str(tmp_path), "-j2", *options, *launcher)
    output_of("make", "-C", "build", "install")
    programs = {f"{package}/{program}" for program, package in PROGRAMS.items()}
    for name in builder.transports():
        programs |= {f"transport_tests/communication_tests_{role}_{name}" for role in ("publisher", "subscriber")}
    programs |= {"topology_tests/topology_node", "transport_tests/topology_node_cyclonedds"}
    installed = {str(path.relative_to("ros/lib")) for path in Path("ros/lib").glob("*_tests*/*")}
    assert installed == programs | {"rt_tests_sampler/rt_tests_sampler", "rt_tests_sampler/rt_tests_allocations.so"}
    for program in programs:
        assert output_of(f"ros/lib/{program}", "--help")
