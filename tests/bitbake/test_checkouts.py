"""Checkouts given to `make test-yocto` that fit no profile."""

import re
import subprocess

import pytest

from bitbake.yocto import open_checkouts
from rtgen.profile import load_profile


def git(folder, *arguments):
    command = ["git", "-C", folder, "-c", "user.name=t", "-c", "user.email=t@localhost", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_a_layer_at_another_commit_is_named_with_both(tmp_path):
    layer = tmp_path / "meta-ros"
    layer.mkdir()
    git(layer, "init", "-q")
    git(layer, "commit", "-q", "--allow-empty", "-m", "other")
    there, pinned = git(layer, "rev-parse", "HEAD"), load_profile("scarthgap-noetic")[0].repositories["meta-ros"].commit
    said = f"scarthgap-noetic: .*meta-ros is at {there}, not at {pinned}"
    with pytest.raises(
        AssertionError, match=re.escape(str(tmp_path)) + rf" holds no profile's checkouts:\n(.*\n)*{said}"
    ):
        open_checkouts(tmp_path)
    with pytest.raises(AssertionError, match="bitbake is at no checkout, not at "):
        open_checkouts(tmp_path)
