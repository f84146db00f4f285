"""The suites built by the real classes of a profile, with Debian's compiler, CMake and ROS instead of Yocto's own.

With ROS 2 they are built for x86-64, on PyPI's wheels, which have rcl and Fast DDS: there is none for ARM.
"""

import os
import shutil
import subprocess
from pathlib import Path

import rtgen.suites
from bitbake.yocto import Yocto
from ros2 import wheels
from rtgen import debian
from rtgen.board import sysroot
from rtgen.layer.recipes import recipes_of

TOOLS = (
    *("gcc", "g++", "cpp", "as", "ld", "ar", "nm", "ranlib", "strip", "objcopy", "objdump"),
    *("gcc-ar", "gcc-nm", "gcc-ranlib"),
)
DEBIAN = """
HOSTTOOLS += "cmake ninja g++ {tools}"
TARGET_PREFIX:forcevariable = "{prefix}"
PYTHON:forcevariable = "{python}"
RECIPE_SYSROOT:forcevariable = "{sysroot}"
# Has options that came after Debian's compiler.
DEBUG_PREFIX_MAP:forcevariable = ""
OECMAKE_EXTRA_ROOT_PATH = "/"
INHERIT += "without-pseudo"
"""
ROS1 = """
# Debian's ROS has a ROS_DISTRO of its own, and its genmsg looks for files under CMake's root paths only.
ROS_DISTRO[unexport] = "1"
export ROS_LANG_DISABLE = "{languages}"
DISTRO_FEATURES:append = " ptest"
"""
ROS2 = """
TARGET_LDFLAGS:append = " {flags}"
# The wheels have none.
EXTRA_OECMAKE:remove = "-DCMAKE_REQUIRE_FIND_PACKAGE_rclcpp='ON'"
"""
# Root can install without pseudo, which would have to be built first.
WITHOUT_PSEUDO = """
python without_pseudo() {
    for task in ("do_install", "do_install_ptest_base"):
        e.data.delVarFlag(task, "fakeroot")
}
addhandler without_pseudo
without_pseudo[eventmask] = "bb.event.RecipeTaskPreProcess"
"""
GOOGLETEST = Path("/usr/src/googletest")  # of Debian's package


def build_suites(yocto: Yocto) -> Path:
    """Fetch, unpack, patch, configure, compile and install each suite's recipe alone; return the build folder."""
    build = yocto.work / "build-suites"
    shutil.rmtree(build, ignore_errors=True)
    # To be added to: links would do so to the one in the cache.
    stage = build / "sysroot"
    if yocto.ros.version != 2:
        # The machine's program headers have to be those of Debian's compiler.
        machine, prefix = yocto.machine if yocto.ros.version else "qemuarm", "arm-linux-gnueabihf-"
        shutil.copytree(sysroot.build("armhf", debian.source()), stage, symlinks=True)
        _install_googletest(build / "googletest", stage)
        more = ROS1.format(languages=rtgen.suites.ROS_LANG_DISABLE)
    else:
        machine, prefix = "qemux86-64", ""
        # The C library, ament and ZeroMQ are this machine's.
        (stage / "usr").mkdir(parents=True)
        for name in ("usr/include", "usr/lib", "usr/share", "lib", "lib64"):
            (stage / name).symlink_to(f"/{name}")
        shutil.copytree(
            wheels.installed(yocto.profile.ros_distro), stage / "opt/ros" / yocto.profile.ros_distro, symlinks=True
        )
        more = ROS2.format(flags=wheels.LINKER_FLAGS)
    tools = " ".join(prefix + tool for tool in TOOLS)
    python = rtgen.suites.SYSTEM_PYTHON
    yocto.configure(build, machine, DEBIAN.format(tools=tools, prefix=prefix, python=python, sysroot=stage) + more)
    (build / "classes").mkdir()
    (build / "classes" / "without-pseudo.bbclass").write_text(WITHOUT_PSEUDO)
    for suite in recipes_of(yocto.profile, yocto.release):
        (recipe,) = yocto.layer.glob(f"recipes-tests/*/{suite.name}_*.bb")
        task = "install_ptest_base" if suite.unit_tests and yocto.ros.version == 1 else "install"
        yocto.run("bitbake", "-b", str(recipe), "-c", task, build=build)
        # Stands for do_populate_sysroot.
        shutil.copytree(work_folder(build, suite.name) / "image", stage, symlinks=True, dirs_exist_ok=True)
    return build


def work_folder(build: Path, recipe: str) -> Path:
    """The work folder of a recipe in a build."""
    (work,) = build.glob(f"tmp*/work/*/{recipe}/*")
    return work


def _install_googletest(build: Path, stage: Path) -> None:
    cross = ("-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_CXX_COMPILER=arm-linux-gnueabihf-g++", "-DBUILD_GMOCK=OFF")
    quiet = "-DCMAKE_CXX_FLAGS=-Wno-psabi"
    configure = ["cmake", "-S", GOOGLETEST, "-B", build, "-DCMAKE_C_COMPILER=arm-linux-gnueabihf-gcc", *cross, quiet]
    environment = os.environ | {"DESTDIR": str(stage)}
    for command in ([*configure, "-DCMAKE_INSTALL_PREFIX=/usr"], ["cmake", "--build", build, "--target", "install"]):
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
