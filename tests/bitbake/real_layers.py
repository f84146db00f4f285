"""A profile against the real layers: what only openembedded-core, meta-openembedded and meta-ros can say.

Not part of `make test`: `make test-yocto LAYERS=DIR` runs it, DIR holding checkouts of a profile's repositories at the
profile's commits, each in a folder of the repository's name. Which profile it is, the commits say. A first run parses
every recipe (minutes), later ones take it from DIR/build. dora needs Python 2.7: python2.7 in the PATH, or its path in
RT_TESTS_PYTHON2. RT_TESTS_CHECK_LAYER=1 adds yocto-check-layer (half an hour on two cores).
"""

import hashlib
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from bitbake.debian_tools import work_folder
from bitbake.yocto import MISSED, MISSING, MISSING_OF_WORLD, unmet_needs
from rtfiles.config import read_yaml
from rtgen import suites as builder
from rtgen.checkout import checkout
from rtgen.layer.recipes import recipes_of
from rtgen.profile import load_machines

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(7200)]


def test_parses_without_a_warning(yocto):
    output = yocto.run("bitbake", "-p")
    # BitBake 1.20 counts nothing when all of it comes from its cache.
    counted = re.search(r"Parsing of (\d+) .bb files complete .* (\d+) errors", output)
    cached = re.search(r"Loaded (\d+) entries from dependency cache", output)
    if counted:
        assert counted[2] == "0"
    assert int((counted or cached)[1]) > 900
    print((counted or cached)[0])


def licence_is_as_recorded(variables: dict[str, str]) -> bool:
    """Whether LIC_FILES_CHKSUM, where a recipe has it and the file is there, is that file's."""
    file, _, checksum = variables["LIC_FILES_CHKSUM"].removeprefix("file://").partition(";md5=")
    return not Path(file).is_file() or hashlib.md5(Path(file).read_bytes()).hexdigest() == checksum


def test_recipes_resolve(yocto):
    assert licence_is_as_recorded(yocto.variables("packagegroup-rt-tests", names=("LIC_FILES_CHKSUM",)))
    for suite in recipes_of(yocto.profile, yocto.release):
        recipe = suite.name
        variables = yocto.variables(recipe, names=("S", "SRC_URI", "LIC_FILES_CHKSUM", "FILE", "DEPENDS", "PV"))
        assert variables["FILE"].startswith(str(yocto.layer)), recipe
        assert variables["S"].endswith("/" + recipe.replace("-", "_"))
        assert "${" not in "".join(variables.values())
        assert {*suite.build} <= set(variables["DEPENDS"].split())
        assert licence_is_as_recorded(variables)


def test_create_spdx_and_cve_check_find_what_they_need(yocto):
    """Each recipe parsed alone, with the classes switched on that the release has."""
    if not yocto.release.modern:
        pytest.skip("dora has neither")
    core, *_ = yocto.kas(yocto.machine)[0]
    classes = [name for name in ("create-spdx", "cve-check") if (core / "classes" / f"{name}.bbclass").is_file()]
    build = yocto.work / "build-sbom"
    yocto.configure(build, yocto.machine, f'INHERIT += "{" ".join(classes)}"')
    licences = json.loads((core / "files" / "spdx-licenses.json").read_text())["licenses"]
    ours = sorted(yocto.layer.glob("recipes-*/*/*.bb"))
    assert len(ours) >= 6
    for recipe in ours:
        names = ("PN", "LICENSE", "LIC_FILES_CHKSUM", "CVE_PRODUCT", "SPDX_LICENSES")
        variables = yocto.variables("-b", str(recipe), names=names, build=build)
        assert variables["SPDX_LICENSES"] == str(core / "files" / "spdx-licenses.json"), recipe
        assert variables["LICENSE"] in {licence["licenseId"] for licence in licences}, recipe
        assert variables["LIC_FILES_CHKSUM"].startswith("file://") and licence_is_as_recorded(variables), recipe
        # An empty one: no database knows the suites, the image or the group of packages.
        assert variables["CVE_PRODUCT"] == {"u-boot-panda": "denx:u-boot"}.get(variables["PN"], ""), recipe


def test_graph_of_the_image(yocto):
    yocto.run("bitbake", "-g", yocto.profile.image.name)
    recipes = set((yocto.build / "pn-buildlist").read_text().split())
    kernel = yocto.profile.machines[yocto.machine].kernel.recipe
    suites = [suite.name for suite in recipes_of(yocto.profile, yocto.release)]
    wanted = {re.sub("^(util-linux|python3)-.*", r"\1", package) for package in yocto.profile.image.packages}
    assert {*suites, "packagegroup-rt-tests", kernel, yocto.profile.ssh.server, *wanted} <= recipes
    if yocto.machine.startswith("pandaboard"):
        assert ("u-boot-panda" if yocto.release.own_u_boot else "u-boot") in recipes
    print(f"{len(recipes)} recipes")


MACHINES = pytest.mark.parametrize("machine", load_machines())


def described(yocto, machine):
    if machine not in yocto.profile.machines:
        pytest.skip(f"{yocto.name} has no {machine}")
    return yocto.profile.machines[machine]


@MACHINES
def test_kernel_and_image_of_a_machine(yocto, machine):
    """Each without all other recipes, which takes seconds, on the layers that kas would take for the machine."""
    machine_of_profile, known = described(yocto, machine), load_machines()[machine]
    kernel, image, modern = machine_of_profile.kernel, yocto.profile.image, yocto.release.modern
    build = yocto.work / "build-kernels" if modern else yocto.build
    mask = [rf'BBMASK = "/(?!{kernel.recipe}_)[^/]*[.]bb(append)?$"'] if modern else []
    yocto.configure(build, machine, *mask)

    names = ("SRC_URI", "PV", "SRCREV", "KERNEL_DEVICETREE", "MACHINE_FEATURES", "SERIAL_CONSOLES", *known.kernel)
    variables = yocto.variables(kernel.recipe, names=names, build=build, masked=modern)
    assert variables["PV"].startswith(kernel.version)
    assert f"file://rt-tests-{machine}.cfg" in variables["SRC_URI"].split()
    assert ("preempt-rt" in variables["SRC_URI"]) == (kernel.rt == "branch")
    if kernel.source is not None:
        assert kernel.source.rt_patch in variables["SRC_URI"] and variables["SRCREV"] == kernel.source.commit
    assert {key: variables[key] for key in known.kernel} == known.kernel
    if known.device_tree is not None:
        compiled = [Path(name).name for name in variables["KERNEL_DEVICETREE"].split()]
        assert Path(known.device_tree).with_suffix(".dtb").name in compiled
    if modern:
        console = machine_of_profile.serial_console
        assert "preempt-rt" in variables["MACHINE_FEATURES"].split()
        assert f"{console.baud};{console.device}" in variables["SERIAL_CONSOLES"].split()

    names = ("IMAGE_INSTALL", "IMAGE_FEATURES", "IMAGE_FSTYPES", "ROOTFS_POSTPROCESS_COMMAND", "WKS_FULL_PATH")
    yocto.configure(build, machine)
    (recipe,) = yocto.layer.glob(f"recipes-*/*/{image.name}.bb")
    seen = yocto.variables(*(("-b", str(recipe)) if modern else (image.name,)), names=names, build=build)
    features = seen["IMAGE_FEATURES"].split()
    assert {"packagegroup-rt-tests", *image.packages} <= set(seen["IMAGE_INSTALL"].split())
    assert f"ssh-server-{yocto.profile.ssh.server}" in features
    assert "rt_tests_ssh_policy" in seen["ROOTFS_POSTPROCESS_COMMAND"]
    assert not {"debug-tweaks", "empty-root-password", "allow-root-login", "allow-empty-password"} & set(features)
    if machine_of_profile.sd_card is not None:
        assert Path(seen["WKS_FULL_PATH"]).is_relative_to(yocto.layer)
    types = " ".join(dict.fromkeys(seen["IMAGE_FSTYPES"].split()))
    yocto.note(machine, kernel=f"{kernel.recipe} {variables['PV'].partition('+git')[0]}", image_types=types)


def graph(yocto, machine, mask):
    """The recipes and the tasks of a machine's image."""
    build, image = yocto.work / "build-machines", yocto.profile.image.name
    yocto.configure(build, machine, mask)
    (build / "task-depends.dot").unlink(missing_ok=True)
    # What is masked may be missed by recipes that BitBake considers and does not take, as those of an SDK.
    output = yocto.run("bitbake", "-g", image, build=build, missing=MISSING)
    drawn = (build / "task-depends.dot").read_text()
    assert unmet_needs(output, drawn) == set()
    tasks = re.findall(r'^"([^"]+)" \[label=', drawn, re.MULTILINE)
    assert f"{image}.do_image_complete" in tasks
    return set((build / "pn-buildlist").read_text().split()), tasks


@pytest.fixture(scope="module")
def mask(yocto):
    if not yocto.release.modern:
        pytest.skip("dora has one machine and no yocto-check-layer, and starts pseudo for a dry run")
    return f'BBMASK = "{yocto.mask_of_needless_recipes()}"'


@pytest.fixture(scope="module")
def needed(yocto, mask):
    """The recipes that the image of the first machine needs."""
    recipes, _ = graph(yocto, yocto.machine, mask)
    return recipes


@MACHINES
def test_graph_of_a_machine(yocto, machine, needed):
    kernel = described(yocto, machine).kernel
    recipes, tasks = graph(yocto, machine, f'BBMASK = "{yocto.mask_of_all_but(needed, machine)}"')
    suites = {suite.name for suite in recipes_of(yocto.profile, yocto.release)}
    assert {
        *suites,
        "packagegroup-rt-tests",
        kernel.recipe,
        yocto.profile.ssh.server,
        "rt-tests",
        "stress-ng",
    } <= recipes
    assert len(tasks) > 1000
    yocto.note(machine, recipes=str(len(recipes)), tasks=str(len(tasks)))


def test_dry_run_of_the_image(yocto, mask):
    """BitBake's queue goes through every task; each parses its recipe once more."""
    build, image = yocto.work / "build-machines", yocto.profile.image.name
    yocto.configure(build, yocto.machine, mask)
    output = yocto.run("bitbake", "-n", image, build=build)
    counted = re.search(r"Attempted (\d+) tasks of which \d+ didn't need to be rerun and all succeeded", output)
    assert counted and int(counted[1]) > 1000, output[-2000:]
    assert f"{image}.bb:do_image_complete" in output, output[-2000:]
    yocto.note(yocto.machine, dry_run=f"{counted[1]} tasks")


def test_suites_are_fetched_and_unpacked(yocto):
    if yocto.profile.suites:
        pytest.skip("the originals of 2014 are in a git repository, and BB_NO_NETWORK is set")
    for suite in recipes_of(yocto.profile, yocto.release):
        recipe = suite.name
        yocto.run("bitbake", "-c", "clean", recipe)
        yocto.run("bitbake", "-c", "unpack", recipe)
        source = Path(yocto.variables(recipe, names=("S",))["S"])
        assert (source / "package.xml").is_file()
        assert (source / "CMakeLists.txt").is_file()


def test_suites_are_compiled_and_installed(yocto, built_suites):
    for suite in recipes_of(yocto.profile, yocto.release):
        work = work_folder(built_suites, suite.name)
        tasks = {path.suffixes[0][1:] for path in work.glob("temp/log.do_*")}
        assert {"do_patch", "do_configure", "do_compile", "do_install"} <= tasks
    ros = yocto.ros
    prefix = Path("opt/ros", yocto.profile.ros_distro, "lib") if ros.version else Path("usr/lib")
    programs = [
        path
        for suite in recipes_of(yocto.profile, yocto.release)
        for path in (work_folder(built_suites, suite.name) / "image" / prefix).glob("*/*")
        if path.parent.name != "pkgconfig"
    ]
    described = read_yaml(checkout() / "recipes-tests/suites.yml")["suites"]
    with_ros = described if ros.version else {}
    # The wheels have no rclcpp.
    client = "_rcl" if ros.version == 2 else ""
    wanted = {f"{suite}/{name}{client}" for suite, entry in with_ros.items() for name in entry["programs"]}
    transports = [name for name, debian in builder.transports().items() if name in ros.transports or not debian]
    names = described["communication_tests"]["programs"]
    wanted |= {f"transport_tests/{program}_{transport}" for program in names for transport in transports}
    wanted |= {f"topology_tests/topology_node{client}"} if ros.version else set()
    assert {f"{path.parent.name}/{path.name}" for path in programs} == {*wanted, "rt_tests_sampler/rt_tests_sampler"}
    for path in programs:
        kind = subprocess.run(["file", "-b", path], capture_output=True, text=True, check=True).stdout
        words = ("64-bit", "x86-64") if ros.version == 2 else ("32-bit", "ARM", "EABI5")
        assert all(word in kind for word in ("ELF", *words)), kind
    if ros.version == 2:
        # Those of x86-64 start here, without ROS' environment, as on a target. The wheels keep some libraries apart.
        stage = built_suites / "sysroot" / prefix
        environment = {"LD_LIBRARY_PATH": ":".join(map(str, stage.glob("python3*/site-packages/*.libs")))}
        for transport in transports:
            program = stage / f"transport_tests/communication_tests_subscriber_{transport}"
            subprocess.run([program, "--help"], env=environment, stdout=subprocess.DEVNULL, check=True)


def mask_of_a_world(yocto, needed, settings):
    """A mask of recipes that an image does not need, in a world of which nothing is missed.

    An image may take a native recipe alone: for a target it may need more.
    """
    build = yocto.work / "build-world"
    missed: set[str] = set()
    while True:
        mask = f'BBMASK = "{yocto.mask_of_others_but(needed | missed)}"'
        yocto.write_configuration(build, yocto.shared_layers, [*yocto.local("qemuarm"), *settings, mask])
        output = yocto.run("bitbake", "-g", "world", build=build, missing=MISSING_OF_WORLD)
        more = {name for name, _ in MISSED.findall(output)} - missed
        if not more:
            return mask
        missed |= more


@pytest.mark.skipif("RT_TESTS_CHECK_LAYER" not in os.environ, reason="takes half an hour: RT_TESTS_CHECK_LAYER=1 asks")
def test_yocto_check_layer(yocto, needed):
    build = yocto.work / "build-check"
    # The machines that need no layer of their own; qemuarm is openembedded-core's.
    machines = [yocto.profile.default_machine, "qemuarm"]
    core, *others = yocto.shared_layers
    # As somebody else has it who adds the layer: nothing of ours is switched on but what its ROS needs.
    settings = [f'{variable} = "{value}"' for variable, value in yocto.ros.set.items()]
    mask = mask_of_a_world(yocto, needed, settings)
    yocto.write_configuration(build, [core], [*yocto.local("qemuarm"), *settings, mask])
    output = yocto.run(
        "yocto-check-layer", str(yocto.layer), "--dependency", *map(str, others), "--no-auto", "--no-auto-dependency",
        "--machines", *machines, build=build,
    )  # fmt: skip
    print(output)
    assert re.search(r"meta-rt-tests \.\.\. PASS", output)
