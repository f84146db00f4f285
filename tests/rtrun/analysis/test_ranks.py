"""What the analysis computes itself, so as not to load scipy.stats, against scipy.stats."""

import math

import numpy as np
import pytest
from scipy.stats import kstest, rankdata, spearmanr

from rtrun.analysis.chance.ranks import rank_correlation, ranks
from rtrun.analysis.order.periods import evenly_spread_p


@pytest.mark.parametrize("different", [2, 5, 1000])
def test_ranks_and_their_correlation(different):
    rng = np.random.default_rng(different)
    first, noise = rng.integers(0, different, 300), rng.integers(0, different, 300)
    assert (ranks(first) == rankdata(first)).all()
    for second in (noise, first + noise, -first, first):
        expected = spearmanr(first, second)
        assert rank_correlation(first, second) == pytest.approx((expected.statistic, expected.pvalue), abs=1e-12)


@pytest.mark.parametrize("values", [[1, 1, 1], [1, 2]])
def test_nothing_to_correlate(values):
    assert all(map(math.isnan, rank_correlation(values, range(len(values)))))


@pytest.mark.parametrize("n", [5, 30, 2000])
@pytest.mark.parametrize("bend", [1.0, 1.2, 1.5, 2.0])
def test_an_even_spread(n, bend):
    places = np.random.default_rng(n).random(n) ** bend
    exact = float(kstest(places, "uniform").pvalue)
    ours = evenly_spread_p(places)
    assert ours == pytest.approx(exact, rel=1e-4) if exact < 0.1 else exact <= ours <= min(1, 2 * exact)
