"""Of the time of observations: what was not seen, and what load hid."""

import pytest

from rtrun.evidence.time_seen import TimeSeen, time_seen
from rtrun.probes.hits import GapCause
from rtrun.results.coverage import Coverage, CoverageGap
from rtrun.results.record import RunRecord


def observed(*gaps):
    """A record of ten seconds with these gaps: (begin, end, cause) in s."""
    every = [CoverageGap(begin_ns=begin * 10**9, end_ns=end * 10**9, cause=cause) for begin, end, cause in gaps]
    seen_ns = 10**10 - sum(gap.end_ns - gap.begin_ns for gap in every)
    coverage = Coverage(begin_ns=0, asked_ns=10**10, seen_ns=seen_ns, gaps=every)
    return RunRecord.model_construct(coverage=coverage)


@pytest.mark.parametrize("cause", [GapCause.RESTED, GapCause.EVENTS_LOST, GapCause.WATCHDOG_SILENT])
def test_what_comes_with_load_counts_as_hidden(cause):
    seen = time_seen([observed((1, 3, cause), (5, 6, GapCause.LINK_LOST)), observed()])
    assert seen == TimeSeen(unseen_share=0.15, hidden_share=0.1)


def test_the_rest_is_not_seen():
    assert time_seen([observed((2, 4, GapCause.LINK_LOST), (9, 10, GapCause.ENDED_EARLY))]).hidden_share == 0


def test_what_measures_by_itself_has_seen_all():
    assert time_seen([RunRecord.model_construct(coverage=None)]) == TimeSeen()
