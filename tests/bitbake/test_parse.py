"""Every profile is parsed by the real BitBake, for each of its machines."""

import pytest

from rtgen.layer.render import suite_recipes
from rtgen.profile import load_profile, profile_names

pytestmark = pytest.mark.bitbake

CASES = [(name, machine) for name in profile_names() for machine in load_profile(name)[0].machines]


@pytest.mark.parametrize(("name", "machine"), CASES)
def test_parses_and_resolves(make_build, name, machine):
    profile, _ = load_profile(name)
    # BitBake 2.19 is fatal on the underscore syntax of dora; the renderings differ in the separator only.
    build = make_build(name, machine, separator=":")
    variables = ["SRC_URI", "S", "DEPENDS", "IMAGE_INSTALL", "LAYERSERIES_COMPAT_rt-tests-layer", "KERNEL_DEVICETREE"]
    recipes = build.bitbake(variables=variables)["recipes"]

    suites = [suite["package"] for suite in suite_recipes(profile)]
    ours = {*suites, "packagegroup-rt-tests", profile.image.name}
    assert ours <= set(recipes)
    for recipe in ours:
        assert not recipes[recipe]["skipped"], recipe
        assert recipes[recipe]["unexpanded"] == [], recipe
    for suite in suites:
        assert "rt-tests-support" in recipes[suite]["variables"]["DEPENDS"] or suite == "rt-tests-support"
        assert recipes[suite]["variables"]["S"].endswith("/" + suite.replace("-", "_"))
    install = recipes[profile.image.name]["variables"]["IMAGE_INSTALL"].split()
    assert {"packagegroup-rt-tests", "openssh-sftp-server", *profile.image.packages} <= set(install)


@pytest.mark.parametrize(("name", "machine"), CASES)
def test_kernel_takes_the_fragment(make_build, name, machine):
    profile, _ = load_profile(name)
    kernel = profile.machines[machine].kernel
    on = f'MACHINE_FEATURES:append:{machine} = " preempt-rt"\n' if machine == "qemuarm" else ""
    build = make_build(name, machine, separator=":", local=on)
    data = build.bitbake(variables=["SRC_URI", "COMPATIBLE_MACHINE", "KBUILD_DEFCONFIG", "SRCREV"])
    recipe = data["recipes"][kernel.recipe]
    assert recipe["appends"]
    assert f"file://rt-tests-{machine}.cfg" in recipe["variables"]["SRC_URI"].split()
    if machine == "pandaboard-es":
        assert "file://omap4-panda-es-rt.dts" in recipe["variables"]["SRC_URI"].split()
        assert recipe["variables"]["KBUILD_DEFCONFIG"] == "omap2plus_defconfig"
        assert recipe["variables"]["COMPATIBLE_MACHINE"] == "pandaboard-es"
    if kernel.source:
        assert recipe["variables"]["SRCREV"] == kernel.source.commit
        assert kernel.source.rt_patch in recipe["variables"]["SRC_URI"]


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


def test_a_recipe_with_an_unknown_class_is_an_error(make_build):
    build = make_build("scarthgap-noetic", "qemuarm")
    recipe = next(build.layer.glob("recipes-tests/suites/oneshot-*.bb"))
    recipe.write_text(recipe.read_text() + "inherit no-such-class\n")
    done = build.try_bitbake()
    assert done.returncode != 0
    assert "no-such-class" in done.stderr
