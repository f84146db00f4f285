"""The time that a campaign has taken, from its journal: pauses between runners do not count."""

from contextlib import closing
from datetime import UTC, datetime

import pytest

from rtfiles.errors import UsageError
from rtrun.execution.campaign_runner import has_rounds
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import digest_of
from rtrun.results.journal import open_journal


def at(seconds):
    return datetime.fromtimestamp(1_800_000_000 + seconds, UTC)


@pytest.fixture
def log(tmp_path):
    with closing(open_journal(tmp_path, "test", "plan", "board")) as log:
        yield log


def test_the_time_of_all_sessions_until_now(log):
    assert log.spent_s(at(50)) == 0
    log.begin_session(at(0).isoformat())
    log.note(at(10).isoformat(), "001", "measuring")
    log.note(at(70).isoformat(), "001", "closed")
    assert log.spent_s(at(75)) == 75
    assert log.spent_s(None) == 70, "between two calls nobody works, however long that is"
    log.begin_session(at(5000).isoformat())
    assert log.spent_s(at(5003)) == 73, "the runner was killed at 70, or later"
    log.note(at(4990).isoformat(), "001", "measuring")
    assert log.spent_s(at(4995)) == 75, "a clock that is set back takes nothing off"


def test_what_is_no_time_is_refused(log):
    log.begin_session("yesterday")
    with pytest.raises(UsageError, match="the journal is damaged"):
        log.spent_s(at(0))
    log.begin_session("2026-01-01T00:00:00")
    with pytest.raises(UsageError, match="the journal is damaged"):
        log.spent_s(at(0))


def test_a_pause_between_two_calls_takes_nothing_from_a_goal(tmp_path):
    groups = plan(Campaign(schema=1, name="test", runs=[{"suite": "cyclic_timer_tests"}]), "test")
    with closing(open_journal(tmp_path, "test", digest_of(groups), "board")) as log:
        log.begin_session("2026-01-01T00:00:00+00:00")
        log.note("2026-01-01T00:00:15+00:00", groups[0].name, "closed")
    spent = []

    def plan_rounds(spent_s):
        spent.append(spent_s())
        return lambda *_: None

    has_rounds(tmp_path, "test", groups, plan_rounds, "board")
    assert spent == [15], "of a goal of 30 s half is left, however long ago that was"
