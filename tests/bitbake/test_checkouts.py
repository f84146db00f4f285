"""Checkouts given to `make test-yocto` that fit no profile, and graphs of them that lack a recipe."""

import re
import subprocess

import pytest

import bitbake.yocto
from bitbake.yocto import Yocto, open_checkouts, unmet_needs
from rtgen.layer import output
from rtgen.layer.render import render
from rtgen.profile import load_profile, profile_names


def git(folder, *arguments):
    command = ["git", "-C", folder, "-c", "user.name=t", "-c", "user.email=t@localhost", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_a_layer_at_another_commit_is_named_with_both(tmp_path, monkeypatch):
    """Of the profile that comes nearest only."""
    profile, release = load_profile("scarthgap-noetic")
    commits = {}
    for name in profile.repositories:
        (tmp_path / name).mkdir()
        git(tmp_path / name, "init", "-q")
        git(tmp_path / name, "commit", "-q", "--allow-empty", "-m", "other")
        commits[name] = git(tmp_path / name, "rev-parse", "HEAD")
    # The profile follows all folders but one: nobody can make a commit of the name that it pins.
    repositories = {
        name: pinned if name == "meta-ros" else pinned.model_copy(update={"commit": commits[name]})
        for name, pinned in profile.repositories.items()
    }
    profiles = {name: load_profile(name) for name in profile_names()}
    profiles["scarthgap-noetic"] = profile.model_copy(update={"repositories": repositories}), release
    monkeypatch.setattr(bitbake.yocto, "load_profile", profiles.get)
    with pytest.raises(AssertionError) as error:
        open_checkouts(tmp_path)
    assert str(error.value) == (
        f"{tmp_path} holds no profile's checkouts, scarthgap-noetic comes nearest:\n"
        f"meta-ros is at {commits['meta-ros']}, not at {profile.repositories['meta-ros'].commit}"
    )


def test_a_layer_that_is_not_there_is_named_with_its_commit(tmp_path):
    with pytest.raises(AssertionError, match=r"\nmeta-ros is not there, it should be at [0-9a-f]{40}"):
        open_checkouts(tmp_path)


# As BitBake 2.8 and 2.18 say and draw it.
SAID = "ERROR: Nothing PROVIDES '{}' (but {} DEPENDS on or otherwise requires it). Close matches:\n"
DRAWN = """digraph depends {
"rcl.do_compile" [label="rcl do_compile\\n:9.2-r0\\n/layers/rcl_9.2.bb"]
"qemu-native.do_build" [label="qemu-native do_build\\n:8.2-r0\\nvirtual:native:/layers/qemu_8.2.bb"]
"rcl.do_compile" -> "qemu-native.do_build"
}
"""


@pytest.mark.parametrize(("needing", "unmet"), [
    ("/layers/rcl_9.2.bb", {"zenoh"}),
    ("/layers/rosbag_1.bb, /layers/rcl_9.2.bb", {"zenoh"}),
    ("virtual:native:/layers/qemu_8.2.bb", {"zenoh"}),
    ("virtual:nativesdk:/layers/qemu_8.2.bb", set()),
    ("/layers/qemu_8.2.bb", set()),
])  # fmt: skip
def test_a_graph_that_lacks_what_one_of_its_recipes_needs(needing, unmet):
    assert unmet_needs(SAID.format("zenoh", needing) + SAID.format("alsa-lib", "/layers/other_1.bb"), DRAWN) == unmet


def test_what_an_append_needs_is_not_masked(tmp_path):
    """As that of meta-ros to iceoryx-posh, which needs cpptoml; one to a recipe of openembedded-core, too."""
    profile, release = load_profile("wrynose-lyrical")
    yocto = Yocto(tmp_path, "wrynose-lyrical", profile, release)
    output.write(render(yocto.name, profile, release), yocto.layer.parent)
    files = {
        "openembedded-core/meta/recipes-core/busybox/busybox_1.bb": "",
        "meta-openembedded/meta-oe/recipes/busybox_%.bbappend": "zlib-ng",
        "meta-openembedded/meta-oe/recipes/zlib-ng_1.bb": "",
        "meta-ros/meta-ros2-lyrical/recipes/rcl/rcl_1.bb": "",
        "meta-ros/meta-ros2-lyrical/appends/rcl/rcl_%.bbappend": "cpptoml",
        "meta-ros/meta-ros2-lyrical/recipes/unused/unused_1.bb": "",
        "meta-ros/meta-ros2-lyrical/appends/unused/unused_%.bbappend": "needless",
        "meta-ros/meta-ros-common/recipes/cpptoml/cpptoml_1.bb": "",
        "meta-ros/meta-ros-common/recipes/needless/needless_1.bb": "",
    }
    for name, needs in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f'DEPENDS:append = " {needs}"\n')
    masks = [re.compile(mask) for mask in yocto.mask_of_needless_recipes().split()]
    masked = {name.rpartition("/")[2] for name in files if any(mask.search(f"{tmp_path}/{name}") for mask in masks)}
    assert masked == {"unused_1.bb", "unused_%.bbappend", "needless_1.bb"}
