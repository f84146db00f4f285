"""Every load lasts as long as a run does: minutes of each, with the real suites (`make test-slow`)."""

from dataclasses import replace
from pathlib import Path

import pytest
from faulty import record

import rtgen.cli
from rtrun.execution import campaign_runner
from rtrun.plan import conditions
from rtrun.plan.campaign import Campaign, plan
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]

TOP = Path(__file__).parents[3]
# The longest that stress-ng of Debian 12 was seen to keep --timer up with --timeout 0 is 26 s.
LASTS_S = 150
LOADS = [name for name, condition in conditions.conditions().conditions.items() if condition.loads]


@pytest.mark.parametrize("condition", LOADS)
def test_a_load_lasts_for_minutes(loopback, ros_master, tmp_path, monkeypatch, condition):
    monkeypatch.chdir(TOP)
    assert rtgen.cli.main(["suites", "build", "--machine", "host"]) == 0
    target = replace(loopback, suites=TOP / "build" / "suites" / "host", master_port=ros_master)
    entry = {"suite": "cyclic_timer_tests", "frequency_hz": 10, "repetitions": 10 * LASTS_S, "condition": condition}
    (run,) = runs = plan(Campaign(schema=1, name="loads", runs=[entry]), "loads")
    campaign_runner.run_campaign(target, "loads", runs, tmp_path / "results", Watching())
    written = record(tmp_path / "results", run)
    assert (written["status"], written["reason"]) == ("ok", None)
    assert written["in_effect"]["observations"] > LASTS_S / 4
    for name, processes in written["requested"]["loads"].items():
        assert written["in_effect"]["loads"][name] >= processes
