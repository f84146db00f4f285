"""What an observation has seen of the time that was asked for."""

import pytest

from rtrun.probes import hits
from rtrun.probes.hits import Gap, GapCause
from rtrun.results import coverage
from rtrun.results.coverage import Coverage

S = 10**9


def covered(*gaps, until_s=28.0):
    """Asked for 28 s from 100 s on; gaps are (from, until, cause) in seconds after the begin."""
    in_ns = [Gap(100 * S + round(a * S), 100 * S + round(b * S), "why", cause) for a, b, cause in gaps]
    return coverage.coverage(begin_ns=100 * S, until_ns=round((100 + until_s) * S), asked_ns=28 * S, gaps=in_ns)


def spans(result):
    return [((gap.begin_ns - 100 * S) / S, (gap.end_ns - 100 * S) / S, gap.cause) for gap in result.gaps]


def test_all_was_seen():
    result = covered(until_s=30)
    assert (result.seen_ns, result.gaps, result.in_words) == (28 * S, [], "")


def test_what_lies_in_two_gaps_is_missed_once():
    result = covered((1, 3, GapCause.RESTED), (2, 4, GapCause.EVENTS_LOST), (2.5, 5, GapCause.EVENTS_LOST))
    assert result.seen_ns == 24 * S
    assert spans(result) == [(1, 3, "rested"), (2, 5, "events lost")]
    assert result.in_words == "24 s of 28 s were seen, with 2 gaps: rested 2 s, events lost 3 s"


def test_a_gap_counts_within_the_time_that_was_asked_for():
    result = covered((-5, 1, GapCause.RESTED), (27, 40, GapCause.LINK_LOST), (50, 60, GapCause.EVENTS_LOST))
    assert spans(result) == [(0, 1, "rested"), (27, 28, "link lost")] and result.seen_ns == 26 * S


@pytest.mark.parametrize("until_s", [2, -3])
def test_what_came_after_an_early_end_was_not_seen(until_s):
    result = covered(until_s=until_s)
    assert result.seen_ns == max(until_s, 0) * S and spans(result) == [(max(until_s, 0), 28, "ended early")]


def test_more_gaps_than_are_kept_are_joined_and_count_as_not_seen(monkeypatch):
    monkeypatch.setattr(hits, "GAPS_MAX", 3)
    result = covered(*((at, at + 0.5, GapCause.RESTED) for at in (1, 2, 10, 11, 20)))
    assert spans(result) == [(1, 2.5, "rested"), (10, 11.5, "rested"), (20, 20.5, "rested")]
    assert result.seen_ns == round(24.5 * S)


def test_it_is_read_as_it_was_written():
    result = covered((1, 3, GapCause.WATCHDOG_SILENT), until_s=20)
    assert Coverage.model_validate_json(result.model_dump_json()) == result
