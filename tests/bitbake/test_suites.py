"""The tasks of the suites' recipes, run by the real BitBake with Debian's cross compiler and ROS sysroot."""

import shutil
import subprocess
from pathlib import Path

import pytest

import rtgen.suites
from rtgen.board import sysroot
from rtgen.checkout import checkout
from rtgen.layer.render import suite_recipes
from rtgen.profile import load_profile

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(900)]

TASKS = ("do_fetch", "do_unpack", "do_configure", "do_compile", "do_install")
TOOLCHAIN = Path(rtgen.suites.__file__).with_name("debian.cmake")
PROGRAMS = {
    "oneshot-timer-tests": ["oneshot_timer_tests"],
    "cyclic-timer-tests": ["cyclic_timer_tests"],
    "communication-tests": ["communication_tests_publisher", "communication_tests_subscriber"],
}


def tools() -> str:
    return (
        f'SYSROOT = "{sysroot.build("armhf")}"\nTOOLCHAIN_FILE = "{TOOLCHAIN}"\n'
        f'BUILD_PYTHON = "{rtgen.suites.SYSTEM_PYTHON}"\n'
        f'export ROS_LANG_DISABLE = "{rtgen.suites.ROS_LANG_DISABLE}"\n'
    )


def tasks(*recipes: str) -> list[list[str]]:
    return [[recipe, task] for recipe in recipes for task in TASKS]


# scarthgap unpacks into WORKDIR as kirkstone does, wrynose into UNPACKDIR.
@pytest.mark.parametrize("name", ["scarthgap-noetic", "wrynose-noetic"])
def test_fetch_to_install(make_build, name):
    build = make_build(name, "pandaboard-es", local=tools())
    suites = [suite["package"] for suite in suite_recipes(load_profile(name)[0])]
    files = build.bitbake(tasks=tasks(*suites))["files"]
    for suite, programs in PROGRAMS.items():
        package = suite.replace("-", "_")
        for program in programs:
            path = f"/opt/ros/noetic/lib/{package}/{program}"
            assert files[suite][path] == suite
            binary = next(build.folder.glob(f"tmp/work/{suite}/*/image{path}"))
            said = subprocess.run(["file", "-b", binary], capture_output=True, text=True, check=True).stdout
            assert "ELF 32-bit" in said and "ARM" in said and "EABI5" in said
        assert files[suite][f"/opt/ros/noetic/share/{package}/package.xml"] == suite
        launch = [path for path in files[suite] if path.endswith(".launch")]
        assert launch and all(files[suite][path] == suite for path in launch)
    for suite in suites:
        assert [path for path, package in files[suite].items() if not package] == []
    library = [path for path, package in files["rt-tests-support"].items() if package == "rt-tests-support"]
    assert not [path for path in library if path.endswith((".a", ".h", ".so"))]
    assert files["rt-tests-support"]["/opt/ros/noetic/lib/librt_tests_support.a"] == "rt-tests-support-staticdev"


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
