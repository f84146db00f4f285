"""By what a campaign is known again when it is resumed."""

import dataclasses
from collections.abc import Mapping

import pytest

from rtrun.plan import suites
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import Run, digest_of
from rtrun.plan.suites import Option

DIGEST = "1:460e44bad51c66814997697dbc01cf7bcb76c07d20a7705288aac94c3286e7d3"
OF_AN_OBSERVATION = "1:9d8354d62f4813a1d595f81a42f1ab4b46fdb44e51441a19fe6c60ebe90529ed"


def runs_of(**values):
    entry = {"suite": "cyclic_timer_tests", "policy": ["RR", "0"], "condition": ["idle", "cpu80"]} | values
    return plan(Campaign(schema=1, name="test", runs=[entry]), "test")


def test_the_canonical_form_does_not_change():
    """Whoever changes it makes every campaign another one: increase the version."""
    assert digest_of(runs_of()) == DIGEST


def test_that_of_an_observation_does_not_change():
    asked = {"subject": "attached", "for": "2min", "deadlines": ["/cmd_vel=5ms", "timer:/c=1ms", "/a,/b=3ms"]}
    campaign = Campaign(schema=1, name="o", paths=["/a,/b,/c"], runs=[{"repeats": 2}], **asked)
    assert digest_of(plan(campaign, "o")) == OF_AN_OBSERVATION


def test_a_field_added_with_its_default_changes_nothing():
    later = dataclasses.make_dataclass(
        "Later",
        [
            ("variant", str, dataclasses.field(default="")),
            ("labels", Mapping, dataclasses.field(default_factory=dict)),
        ],
        bases=(Run,),
        frozen=True,
        kw_only=True,
    )
    runs = runs_of()
    fields = [field.name for field in dataclasses.fields(Run)]
    same = [later(**{name: getattr(run, name) for name in fields}) for run in runs]
    assert digest_of(same) == digest_of(runs)
    assert digest_of([dataclasses.replace(run, variant="other") for run in same]) != digest_of(runs)


def test_an_option_added_with_its_default_changes_nothing(monkeypatch):
    runs = runs_of()
    added = Option(type="int", min=0, max=9, default=3, help="added later", flag="--added")
    options = suites.options() | {"added": added}
    before = digest_of(runs)
    monkeypatch.setattr(suites, "options", lambda: options)
    assert digest_of([dataclasses.replace(run, parameters={**run.parameters, "added": 3}) for run in runs]) == before
    assert digest_of([dataclasses.replace(run, parameters={**run.parameters, "added": 4}) for run in runs]) != before


@pytest.mark.parametrize("change", [{"repetitions": 1001}, {"policy": "RR"}, {"condition": "idle"}, {"repeats": 2}])
def test_another_campaign_has_another_digest(change):
    assert digest_of(runs_of(**change)) != digest_of(runs_of())


def test_an_option_that_came_later_changes_nothing():
    (run,) = plan(Campaign(schema=1, name="test", runs=[{"suite": "cyclictest"}]), "test")
    before = {key: value for key, value in run.parameters.items() if key != "deepest_idle_state"}
    assert before != run.parameters and digest_of([run]) == digest_of([dataclasses.replace(run, parameters=before)])


def test_what_cyclictest_did_by_itself_changes_nothing():
    entry = {"suite": "cyclictest", "cpu_dma_latency_us": [0, None]}
    awake, asleep = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    before = {key: value for key, value in awake.parameters.items() if key != "cpu_dma_latency_us"}
    assert digest_of([awake]) == digest_of([dataclasses.replace(awake, parameters=before)])
    assert digest_of([awake]) != digest_of([dataclasses.replace(asleep, name=awake.name)])
