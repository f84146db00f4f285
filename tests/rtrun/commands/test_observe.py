"""The number that `rtrun observe` takes in a folder of results."""

import pytest

from rtrun.cli import main
from rtrun.execution import run_execution
from rtrun.results import run_directory
from rtrun.results.run_state import RunEvent
from rtrun.targets.errors import TargetError


@pytest.mark.parametrize("has_begun", [True, False])
def test_an_observation_says_that_it_has_begun(tmp_path, monkeypatch, has_begun):
    """Whoever kills it then does not get rid of it: its attempt counts as late."""

    def measure(_ready, _uid, _campaign, _run, folder, life, _now, **_more):
        life.move(RunEvent.BEGIN)
        if has_begun:
            life.move(RunEvent.OBSERVE)
        assert run_directory.numbers_begun(folder.parent) == dict.fromkeys(["001"] * has_begun, True)
        raise TargetError("nothing is observed here")

    monkeypatch.setattr(run_execution, "measure", measure)
    target = tmp_path / "target.yml"
    # It uses no suites, so nobody has to build them.
    target.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\nsuites: nowhere\n")
    assert main(["observe", "--target", str(target), "--results", str(tmp_path / "results")]) == 3
    assert run_directory.numbers_begun(tmp_path / "results") == {}, "it was not killed"
