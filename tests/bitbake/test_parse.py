"""Every profile is parsed by the real BitBake, for each of its machines."""

import pytest

from rtgen.layer.recipes import CLIENTS, recipes_of
from rtgen.profile import load_machines, load_profile, profile_names

pytestmark = pytest.mark.bitbake

CASES = [(name, machine) for name in profile_names() for machine in load_profile(name)[0].machines]


VARIABLES = ["SRC_URI", "S", "DEPENDS", "IMAGE_INSTALL", "COMPATIBLE_MACHINE", "KBUILD_DEFCONFIG", "KMACHINE", "SRCREV"]


@pytest.mark.parametrize(("name", "machine"), CASES)
def test_recipes_resolve_and_the_kernel_takes_the_fragment(make_build, name, machine):
    profile, release = load_profile(name)
    kernel, facts = profile.machines[machine].kernel, load_machines()[machine]
    on = "" if facts.layer == "meta-rt-tests" else f'MACHINE_FEATURES:append:{machine} = " preempt-rt"\n'
    # BitBake 2.19 is fatal on the underscore syntax of dora; the renderings differ in the separator only.
    build = make_build(
        name, machine, separator=":", local=f'{on}PREFERRED_PROVIDER_virtual/kernel = "{kernel.recipe}"\n'
    )
    suites = {suite.name: suite for suite in recipes_of(profile, release)}
    recipes = build.bitbake(variables=[*VARIABLES, *(f"RDEPENDS:{name}" for name in suites)])["recipes"]

    ours = {*suites, "packagegroup-rt-tests", profile.image.name}
    assert ours <= set(recipes)
    for recipe in ours:
        assert not recipes[recipe]["skipped"], recipe
        assert recipes[recipe]["unexpanded"] == [], recipe
    clients = CLIENTS[release.ros_distros[profile.ros_distro].version]
    for name, suite in suites.items():
        variables = recipes[name]["variables"]
        needs = (variables["DEPENDS"] or "").split()
        assert needs == list(suite.build)
        assert ("rt-tests-support" in needs) == (name not in ("rt-tests-support", "rt-tests-sampler"))
        if name in ("oneshot-timer-tests", "cyclic-timer-tests", "communication-tests"):
            assert {*clients} <= {*needs} and {*clients} <= {*variables[f"RDEPENDS:{name}"].split()}
        assert variables["S"].endswith("/" + name.replace("-", "_"))
    install = recipes[profile.image.name]["variables"]["IMAGE_INSTALL"].split()
    assert {"packagegroup-rt-tests", *profile.image.packages} <= set(install)

    recipe = recipes[kernel.recipe]
    assert recipe["appends"] and not recipe["skipped"]
    sources = recipe["variables"]["SRC_URI"].split()
    assert f"file://rt-tests-{machine}.cfg" in sources
    assert (f"file://{facts.device_tree}" in sources) == (facts.device_tree is not None)
    settings = {key: value for key, value in facts.kernel.items() if key in VARIABLES}
    assert settings.items() <= recipe["variables"].items()
    if kernel.source:
        assert recipe["variables"]["SRCREV"] == kernel.source.commit
        assert f"{kernel.source.rt_patch};name=rt" in sources


def test_the_fragment_of_a_kernel_in_a_layer_that_may_be_absent_is_fetched(make_build):
    """Its append lies deeper in the layer than the fragment."""
    local = 'MACHINE_FEATURES:append:raspberrypi5 = " preempt-rt"\n'
    build = make_build("scarthgap-noetic", "raspberrypi5", local=local)
    build.bitbake(tasks=[["linux-raspberrypi", "do_fetch"], ["linux-raspberrypi", "do_unpack"]])
    assert next(build.folder.glob("tmp/work/linux-raspberrypi/*/rt-tests-raspberrypi5.cfg")).is_file()


@pytest.mark.parametrize(("kernel", "features", "skipped"), [
    ("linux-yocto", "preempt-rt", True), ("linux-yocto", "", False), ("linux-yocto-rt", "preempt-rt", False),
])  # fmt: skip
def test_an_image_whose_kernel_gets_no_fragment_is_skipped(make_build, kernel, features, skipped):
    local = f'PREFERRED_PROVIDER_virtual/kernel = "{kernel}"\nMACHINE_FEATURES:append:qemuarm = " {features}"\n'
    image = make_build("scarthgap-noetic", "qemuarm", local=local).bitbake()["recipes"]["rt-tests-image"]
    wanted = (
        f"PREFERRED_PROVIDER_virtual/kernel is {kernel}, for which this layer has no kernel options: set it to one of"
    )
    assert (image["skipped"] or "").startswith(wanted) == skipped


@pytest.mark.parametrize("name", ["kirkstone-noetic", "scarthgap-noetic", "wrynose-lyrical"])
def test_an_image_is_light_by_the_lines_of_kas_yml(make_build, name):
    """The values are those of openembedded-core, and another beside them that stays."""
    _, release = load_profile(name)
    found = {
        "DISTRO_FEATURES": ("acl x11", "acl"),
        "EXTRA_IMAGEDEPENDS": ("qemu-system-native qemu-helper-native:do_addto_recipe_sysroot u-boot", "u-boot"),
        "MACHINE_ESSENTIAL_EXTRA_RDEPENDS": ("v86d other", "other"),
        "SHAREDMIMEDEP": ("shared-mime-info", "shared-mime-info"),  # of glib alone it is empty
    }
    lines = [f'{variable} = "{before}"' for variable, (before, _) in found.items()]
    lines += [f'{key} = "{value}"' for settings in release.left_out.values() for key, value in settings.items()]
    build = make_build(name, "qemuarm", local="\n".join(lines) + "\n")
    variables = build.bitbake(variables=list(found))["recipes"]["rt-tests-image"]["variables"]
    assert {name: value.strip() for name, value in variables.items()} == {
        name: left for name, (_, left) in found.items()
    }


@pytest.mark.parametrize("name", ["scarthgap-base", "wrynose-base"])
def test_an_image_without_ros_is_built_without_qemu(make_build, name):
    """By the lines of kas.yml, which name the image; others keep what it needs."""
    _, release = load_profile(name)
    lines = [f'{key} = "{value}"' for key, value in release.left_out["qemu-usermode"].items()]
    lines.append('DEPENDS:pn-other = "qemuwrapper-cross"')
    image = 'DEPENDS:pn-rt-tests-image = "qemuwrapper-cross cross-localedef-native depmodwrapper-cross"'
    build = make_build(name, "qemux86-64", local="\n".join([*lines, image]) + "\n")
    recipes = build.bitbake(variables=["DEPENDS"])["recipes"]
    assert recipes["rt-tests-image"]["variables"]["DEPENDS"].split() == ["depmodwrapper-cross"]


@pytest.mark.parametrize("name", ["kirkstone-noetic", "scarthgap-noetic", "wrynose-noetic"])
def test_an_image_with_ros_1_has_the_master_and_what_it_imports(make_build, name):
    """No package of ROS names xmlrpc, and nothing needs roslaunch, through which all of Python came."""
    image = make_build(name, "qemuarm").bitbake(variables=["IMAGE_INSTALL"])["recipes"]["rt-tests-image"]
    installed = set(image["variables"]["IMAGE_INSTALL"].split())
    assert {"rosmaster", "catkin", "python3-xmlrpc"} <= installed
    assert not {"roslaunch", "rosbash", "rosnode", "rostopic"} & installed


def test_kernel_of_others_stays_as_it_is(make_build):
    recipe = make_build("scarthgap-noetic", "qemuarm").bitbake(variables=["SRC_URI"])["recipes"]["linux-yocto-rt"]
    assert recipe["variables"]["SRC_URI"].strip() == ""


@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        ("", None),
        ('MACHINEOVERRIDES = "pandaboard-es:third"\n', "rt-tests-pandaboard-es.cfg"),
        ('RT_TESTS_FRAGMENT = "mine.cfg"\n', "mine.cfg"),
    ],
)
def test_kernel_of_a_machine_that_is_not_in_the_profile(make_build, more, fragment):
    build = make_build("scarthgap-noetic", "third")
    (build.folder / "conf/machine").mkdir()
    (build.folder / "conf/machine/third.conf").write_text('MACHINE_FEATURES = "preempt-rt"\n' + more)
    kernel = build.bitbake(variables=["SRC_URI"])["recipes"]["linux-yocto-rt"]
    if fragment:
        assert not kernel["skipped"]
        assert f"file://{fragment}" in kernel["variables"]["SRC_URI"].split()
    else:
        assert "no kernel options for third: take preempt-rt out of its MACHINE_FEATURES, or name" in kernel["skipped"]


@pytest.mark.parametrize("features", ["", "ptest"])
def test_unit_tests_come_with_ptest(make_build, features):
    build = make_build("scarthgap-noetic", "qemuarm", local=f'DISTRO_FEATURES = "{features}"\n')
    tasks = [["rt-tests-support", "do_fetch"], ["rt-tests-support", "do_unpack"]]
    recipe = build.bitbake(variables=["DEPENDS"], tasks=tasks)["recipes"]["rt-tests-support"]
    (work,) = build.folder.glob("tmp/work/rt-tests-support/*")
    assert ("googletest" in recipe["variables"]["DEPENDS"].split()) == bool(features)
    assert (work / "unit_tests/run-ptest").is_file() == bool(features)


def test_a_recipe_with_an_unknown_class_is_an_error(make_build):
    build = make_build("scarthgap-noetic", "qemuarm")
    recipe = next(build.layer.glob("recipes-tests/suites/oneshot-*.bb"))
    recipe.write_text(recipe.read_text() + "inherit no-such-class\n")
    done = build.try_bitbake()
    assert done.returncode != 0
    assert "no-such-class" in done.stderr
