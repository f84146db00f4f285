"""What the recipes install is what runs: programs that BitBake made measure on the emulated board."""

import json
import shutil
from pathlib import Path

import pytest

import rtgen.cli
import rtgen.suites
import rtrun.cli
from rtgen.board import sysroot
from rtgen.checkout import checkout
from rtgen.layer.render import suite_recipes
from rtgen.profile import DEFAULT_PROFILE, load_profile

pytestmark = [pytest.mark.bitbake, pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(1200)]

CAMPAIGN = """schema: 1
name: recipes
common: {repetitions: 20, policy: RR}
runs:
  - {suite: oneshot_timer_tests}
  - {suite: cyclic_timer_tests, frequency_hz: 50}
  - {suite: communication_tests, frequency_hz: 50}
"""


def test_programs_of_the_recipes_measure_on_the_board(make_build, tmp_path, monkeypatch):
    toolchain = Path(rtgen.suites.__file__).with_name("debian.cmake")
    local = (
        f'SYSROOT = "{sysroot.build("armhf")}"\nTOOLCHAIN_FILE = "{toolchain}"\n'
        f'BUILD_PYTHON = "{rtgen.suites.SYSTEM_PYTHON}"\n'
        f'export ROS_LANG_DISABLE = "{rtgen.suites.ROS_LANG_DISABLE}"\n'
    )
    build = make_build(DEFAULT_PROFILE, "qemuarm", local=local)
    recipes = [suite["package"] for suite in suite_recipes(load_profile(DEFAULT_PROFILE)[0])]
    tasks = ("do_fetch", "do_unpack", "do_configure", "do_compile", "do_install")
    build.bitbake(tasks=[[recipe, task] for recipe in recipes for task in tasks])

    suites = tmp_path / "suites"
    suites.mkdir()
    rtgen.suites.collect(build.folder / "tmp" / "stage" / "opt" / "ros" / "noetic", suites)
    shutil.copyfile(checkout() / "recipes-tests" / "suites.yml", suites / "suites.yml")
    (suites / "build.json").write_text(json.dumps({"schema": 1, "machine": "qemu-armv7"}))

    monkeypatch.chdir(tmp_path)
    assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    (tmp_path / "target.yml").write_text(
        "schema: 1\nname: qemu-armv7\nkind: qemu\nboard: build/board/qemu-armv7\nsuites: suites\n"
    )
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    assert rtrun.cli.main(["run", "campaign.yml", "--target", "target.yml"]) == 0
    records = [json.loads(path.read_text()) for path in (tmp_path / "results" / "recipes").glob("*/run.json")]
    assert len(records) == 3
    assert {record["status"] for record in records} == {"ok"}
