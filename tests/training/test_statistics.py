"""Intervals against numbers worked out by hand, and against simulated experiments."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from fovconn_env.training.evaluation import statistics
from fovconn_env.training.evaluation.statistics import (
    NOTHING,
    Estimate,
    improvement,
    iqm,
    paired_mean_difference,
    paired_share_difference,
    share_interval,
    survival,
)

NAN = math.nan


def same(found, wanted):
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)
    return True


# ------------------------------------------------------------------------------------------------------------- shares
def test_share_interval():
    """Wilson, 8 of 10: (p + z2/2n -+ z sqrt(p q / n + z2 / 4n2)) / (1 + z2/n)."""
    z2 = norm.ppf(0.975) ** 2
    middle, reach = 0.8 + z2 / 20, math.sqrt(z2) * math.sqrt(0.016 + z2 / 400)
    hits = np.array([1.0] * 8 + [0.0] * 2)
    assert same(share_interval(hits), [(middle - reach) / (1 + z2 / 10), (middle + reach) / (1 + z2 / 10)])


def test_paired_share_difference():
    """Ten pairs, three for a, one for b: shares of 4/12 and 2/12 after the two imaginary pairs."""
    a = np.array([1, 1, 1, 0, 1, 1, 0, 0, 1, 1.0])
    b = np.array([0, 0, 0, 1, 1, 1, 0, 0, 1, 1.0])
    reach = norm.ppf(0.975) * math.sqrt((1 / 2 - 1 / 36) / 12)
    assert same(paired_share_difference(a, b), [0.2, 1 / 6 - reach, 1 / 6 + reach])
    value, low, high = paired_share_difference(b, a)
    assert same([value, low, high], [-0.2, -1 / 6 - reach, -1 / 6 + reach])


def test_shares_that_agree_everywhere_are_not_known_exactly():
    value, low, high = paired_share_difference(np.ones(50), np.ones(50))
    assert value == 0.0
    assert -0.07 < low < -0.05
    assert high == -low
    assert paired_share_difference(np.ones(1), np.zeros(1)).high <= 1.0
    assert paired_share_difference(np.zeros(500), np.ones(500)).low == -1.0


# -------------------------------------------------------------------------------------------------------------- means
def test_paired_mean_difference():
    a, b = np.array([3.0, 5.0, NAN, 9.0]), np.array([1.0, 4.0, 2.0, NAN])
    value, low, high = paired_mean_difference(a, b)
    assert (value, low, high) == (1.5, 1.0, 2.0)
    wide = np.random.default_rng(0).normal(size=400)
    value, low, high = paired_mean_difference(100 * wide + wide[::-1], 100 * wide)  # the pairs' own spread is 1
    assert 0.15 < high - low < 0.25
    assert low < value < high


def test_iqm_is_the_mean_of_the_middle_half():
    assert iqm([np.arange(8.0)]).value == 3.5
    assert iqm([np.array([0.0, 2.0, 100.0, -70.0]), np.array([3.0, 4.0, 5.0, 1.0])]).value == 2.5
    assert iqm([np.array([5.0, NAN, 5.0])]) == Estimate(5.0, 5.0, 5.0)


def test_iqm_resamples_within_strata():
    """Two strata without any spread: how many of each are drawn does not vary, so neither does the mean."""
    assert same(iqm([np.zeros(20), np.ones(20)]), [0.5, 0.5, 0.5])


def test_improvement():
    """1 = 1, 1 < 3, 2 > 1, 2 < 3: one and a half of four; then a stratum that is won."""
    a, b = np.array([1.0, 2.0]), np.array([1.0, 3.0])
    assert improvement([a], [b]).value == 0.375
    assert improvement([a, np.full(3, 5.0)], [b, np.zeros(3)]).value == 0.6875
    assert improvement([b], [a]).value == 0.625
    assert improvement([np.array([1.0, NAN, 2.0, 7.0])], [np.array([1.0, 5.0, 3.0, NAN])]).value == 0.375


def test_a_policy_is_no_better_than_itself():
    a = np.random.default_rng(1).normal(size=30)
    assert same(improvement([a], [a]), [0.5, 0.5, 0.5])


def test_strata_are_resampled_for_themselves():
    """Of two strata alike the mean is surer than one; were both resampled alike it would not be."""
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=100), rng.normal(size=100)
    one, two = improvement([a], [b]), improvement([a, a], [b, b])
    assert two.value == one.value
    assert 0.6 < (two.high - two.low) / (one.high - one.low) < 0.8


def test_nothing_and_one():
    empty, one = np.array([NAN]), np.array([2.0])
    lost = improvement([empty], [one]), improvement([one], [empty])
    for found in (paired_mean_difference(empty, one), iqm([empty]), iqm([]), *lost):
        assert same(found, NOTHING)
    for found, value in ((paired_mean_difference(one, one), 0.0), (iqm([one]), 2.0), (improvement([one], [one]), 0.5)):
        assert same(found, [value, NAN, NAN])
    assert same(improvement([one, np.ones(9)], [one, np.ones(9)]), [0.5, NAN, NAN])


def test_the_same_again():
    rng = np.random.default_rng(3)
    a, b = [rng.normal(size=20) for _ in range(3)], [rng.normal(size=20) for _ in range(3)]
    first = iqm(a), improvement(a, b), paired_mean_difference(a[0], b[0])
    statistics._weights.cache_clear()
    assert (iqm(a), improvement(a, b), paired_mean_difference(a[0], b[0])) == first


# ----------------------------------------------------------------------------------------------------------- survival
def test_survival():
    """Five teams; one is lost at 1 s, one at 3 s of the three then left, and the others are seen until 2 and 4 s."""
    curve = survival(np.array([1.0, 2.0, 3.0, 4.0, 4.0]), np.array([1, 0, 1, 0, 0]))
    assert same(curve.times, [0, 1, 2, 3, 4])
    assert same(curve.share, [1, 4 / 5, 4 / 5, 4 / 5 * 2 / 3, 4 / 5 * 2 / 3])
    # log-log: S^exp(+-z sqrt(Greenwood's sum) / log S); after the first loss the sum is 1 / (5 * 4)
    reach = norm.ppf(0.975) * math.sqrt(1 / 20) / abs(math.log(0.8))
    assert same([curve.low[1], curve.high[1]], [0.8 ** math.exp(reach), 0.8 ** math.exp(-reach)])


def test_survival_without_loss_and_without_survivors():
    curve = survival(np.array([4.0, 4.0]), np.array([0, 0]))
    assert same([curve.share, curve.low, curve.high], np.ones((3, 2)))
    curve = survival(np.array([1.0, 2.0]), np.array([1, 1]))
    assert same(curve.share, [1.0, 0.5, 0.0])
    assert curve.low[-1] == 0.0
    assert curve.high[-1] == curve.high[-2]


# ----------------------------------------------------------------------------------------------------------- coverage
@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 60])
def test_intervals_cover_the_truth(count):
    """Of 300 simulated experiments on seeds that both policies share, near 95 % of the intervals hold the truth."""
    rng, hits = np.random.default_rng(count), np.zeros(4)
    share = norm.cdf([1.5 / math.sqrt(2), 1.2 / math.sqrt(2)])
    truth = share[0] - share[1], 0.4, 0.0, norm.cdf(0.4 / 2)
    for _ in range(300):
        seed, mine, yours = rng.normal(size=(3, count))
        a, b = seed + mine + 0.4, seed + yours
        found = (
            paired_share_difference((seed + mine > -1.5) * 1.0, (seed + yours > -1.2) * 1.0),
            paired_mean_difference(a, b),
            iqm([seed[: count // 2], seed[count // 2 :]]),
            improvement([a], [b]),
        )
        hits += [low <= right <= high for (_, low, high), right in zip(found, truth, strict=True)]
    assert (hits / 300 > (0.88 if count < 50 else 0.92)).all(), hits / 300
    assert (hits[1:] / 300 < 0.99).all(), hits / 300  # the adjusted Wald interval is wide for few seeds
