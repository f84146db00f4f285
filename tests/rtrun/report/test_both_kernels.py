"""A campaign on both kernels: the published table is covered, and the claims are examined with PREEMPT_RT alone."""

from pathlib import Path

import pytest
from report.campaigns import latencies, oneshot_run

from rtrun.judgement.study import study
from rtrun.plan.campaign import read_campaign
from rtrun.thesis.examination import Finding
from rtrun.thesis.examiners import examine_claims
from rtrun.thesis.published import published_figures

CAMPAIGN = Path(__file__).parents[3] / "campaigns" / "thesis-2014.yml"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The one-shot timers of the shipped campaign; on the standard kernel latencies reach 500 us."""
    root = tmp_path_factory.mktemp("results") / "thesis-2014"
    for run in read_campaign(CAMPAIGN)[1]:
        if run.suite == "oneshot_timer_tests":
            timeout_us = run.parameters["timeout_us"]
            values = latencies(200, 1)
            if run.kernel == "standard":
                values[100] = 500_000
            target = {"name": "board", "kernel_release": f"6.1-{run.kernel}", "preempt_rt": run.kernel == "rt"}
            record = {"condition": run.condition, "kernel": run.kernel, "target": target}
            oneshot_run(root, run.name, values, policy=run.parameters["policy"], timeout_us=timeout_us, **record)
    return root


def test_all_24_published_rows_stand_beside_what_was_measured(results):
    examined = study(results, bounds=False)
    assert len(examined.groups) == 24
    published = published_figures(examined)
    assert published.outcome == "24 of the 24 rows of the one-shot table were measured here"
    assert len(published.rows) == 24 and len({row[:2] for row in published.rows}) == 24
    for label, there, *_ in published.rows:
        assert ("kernel=rt" in label) == ("3.4.0-rt17" in there)
        assert ("condition=cpu80" in label) == ("80 % load" in there)


def test_the_claims_are_about_preempt_rt(results):
    whole = study(results, bounds=False)
    result = next(claim.result for claim in examine_claims(whole) if claim.id == "oneshot-400us-rare")
    assert result.finding != Finding.REFUTED and "0 of " in result.numbers
    assert result.runs and all(run.endswith("-rt") for run in result.runs)
