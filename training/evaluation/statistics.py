"""Statistics of episodes with 95 % intervals, after Agarwal et al., NeurIPS 2021.

Two policies fly the same seeds: `a` and `b` of a comparison are paired, entry by entry. A stratum is a scenario. Every
resample comes from a generator with a fixed seed, so that the same episodes always give the same numbers.

scipy is imported where it is used: that takes longer than all other imports, and processes that fly need none of it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

LEVEL = 0.95
RESAMPLES = 2000
SEED = 7  # of all resamples


class Estimate(NamedTuple):
    """A number and its interval; the ends are NaN where one observation, or none, says nothing about them."""

    value: float
    low: float
    high: float


NOTHING = Estimate(math.nan, math.nan, math.nan)


class Survival(NamedTuple):
    """A curve that steps: from `times[k]` on, the share is `share[k]`."""

    times: np.ndarray  # (K,), increasing from 0
    share: np.ndarray  # (K,)
    low: np.ndarray  # (K,)
    high: np.ndarray  # (K,)


def share_interval(hits: np.ndarray) -> tuple[float, float]:
    """Wilson's score interval of a share; hits: (E,) of 0 and 1."""
    from scipy.special import ndtri

    count, share, z = len(hits), int(hits.sum()) / len(hits), float(ndtri(0.5 + LEVEL / 2))
    width = 2 * (count + z**2)
    centre, reach = (2 * count * share + z**2) / width, z / width * math.sqrt(4 * count * share * (1 - share) + z**2)
    return 0.0 if share == 0 else centre - reach, 1.0 if share == 1 else centre + reach


def paired_share_difference(a: np.ndarray, b: np.ndarray) -> Estimate:
    """Share of a less that of b, (E,) of 0 and 1 each, with Bonett and Price's adjusted Wald interval.

    One imaginary pair of each discordant kind keeps it from shrinking to a point where a and b agree everywhere.
    Bonett and Price, J. Educational and Behavioral Statistics 37(4), 2012.
    """
    from scipy import stats

    only_a, only_b, count = int(np.sum(a > b)), int(np.sum(b > a)), len(a)
    p, q = (only_a + 1) / (count + 2), (only_b + 1) / (count + 2)
    z = float(stats.norm.ppf(0.5 + LEVEL / 2))
    reach = z * math.sqrt((p + q - (p - q) ** 2) / (count + 2))
    return Estimate((only_a - only_b) / count, max(p - q - reach, -1.0), min(p - q + reach, 1.0))


def paired_mean_difference(a: np.ndarray, b: np.ndarray) -> Estimate:
    """Mean of a less b, (E,) each, over the pairs without NaN; percentile bootstrap over the pairs."""
    differences = np.asarray(a, float) - b
    return _bootstrap([differences[np.isfinite(differences)]], _mean)


def mean_difference(a: Sequence[np.ndarray], b: Sequence[np.ndarray], comparisons: int = 1) -> Estimate:
    """Mean over tasks of the mean of a less b, paired; (E_k,) each, of the first E_k seeds of one list.

    A seed is one observation of all tasks, since they share starts and courses: the variance is the linearised one of a
    mean over clusters (Cochran, Sampling Techniques, 1977, Sec. 11), the interval normal. comparisons: as many such
    intervals hold together with the probability LEVEL (Bonferroni).
    """
    from scipy import stats

    shares = np.zeros(max(map(len, a)))  # of each seed in the error of the mean
    differences = [np.asarray(x, float) - y for x, y in zip(a, b, strict=True)]
    for each in differences:
        shares[: len(each)] += (each - each.mean()) / (len(each) * len(differences))
    value, count = float(np.mean([each.mean() for each in differences])), len(shares)
    if count < 2:
        return Estimate(value, math.nan, math.nan)
    z = float(stats.norm.isf((1 - LEVEL) / 2 / max(comparisons, 1)))
    reach = z * math.sqrt(count / (count - 1) * float(shares @ shares))
    return Estimate(value, value - reach, value + reach)


def mean(values: np.ndarray) -> Estimate:
    """Mean of independent observations, (E,), with Student's interval: a bootstrap's is too narrow for five trainings.

    NaN are left out.
    """
    from scipy import stats

    values = values[np.isfinite(values)]
    if len(values) < 2:
        return Estimate(float(values[0]), math.nan, math.nan) if len(values) else NOTHING
    value, t = float(values.mean()), float(stats.t.isf((1 - LEVEL) / 2, len(values) - 1))
    reach = t * float(values.std(ddof=1)) / math.sqrt(len(values))
    return Estimate(value, value - reach, value + reach)


def iqm(strata: Sequence[np.ndarray]) -> Estimate:
    """Interquartile mean of all strata's values together, (E_s,) each; stratified percentile bootstrap.

    The mean of the middle half: neither a few lucky episodes nor a few wrecks decide it. NaN are left out.
    """
    return _bootstrap([values[np.isfinite(values)] for values in strata], _trimmed)


def improvement(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> Estimate:
    """P(A > B) + P(A = B) / 2 of two policies' values, the mean over strata; (E_s,) each, paired by seed.

    Within a stratum A and B are drawn independently, as in Agarwal et al. (2021, Sec. 4.3): all E_s^2 comparisons
    count. The bootstrap draws seeds, with what both policies made of them. Pairs with a NaN are left out.
    """
    values, resamples = [], []
    for s, (x, y) in enumerate(zip(a, b, strict=True)):
        whole = np.isfinite(x) & np.isfinite(y)
        signs = np.sign(x[whole][:, None] - y[whole][None])  # (E, E)
        if not whole.any():
            continue
        drawn = _weights(len(signs), s)  # (R, E), shares
        values.append(0.5 + 0.5 * signs.mean())
        alone = math.nan if len(signs) == 1 else 0.5
        resamples.append(alone + 0.5 * ((drawn @ signs) * drawn).sum(-1))
    if not values:
        return NOTHING
    low, high = np.quantile(np.mean(resamples, 0), [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return Estimate(float(np.mean(values)), float(low), float(high))


def survival(times: np.ndarray, lost: np.ndarray) -> Survival:
    """Share not yet lost over time after Kaplan and Meier, with Greenwood's log-log band.

    times (E,): of the loss where `lost` (E,), else of the last moment seen. Before the first loss the band is closed;
    once all are lost its upper edge stays.
    """
    from scipy import stats

    lost = np.asarray(lost, bool)
    curve = stats.ecdf(stats.CensoredData(uncensored=times[lost], right=times[~lost])).sf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # undefined at shares of 1 and 0
        band = curve.confidence_interval(LEVEL, method="log-log")
    low = np.concatenate([[1.0], band.low.probabilities])
    high = np.concatenate([[1.0], band.high.probabilities])
    share = np.concatenate([[1.0], curve.probabilities])
    low[share == 1.0] = high[share == 1.0] = 1.0
    low[share == 0.0] = 0.0
    for k in np.flatnonzero(np.isnan(high)):
        high[k] = high[k - 1]
    return Survival(np.concatenate([[0.0], curve.quantiles]), share, low, high)


def _bootstrap(strata: list[np.ndarray], statistic: Callable[..., np.ndarray]) -> Estimate:
    """A statistic of several samples, each resampled for itself."""
    from scipy import stats

    strata = [values for values in strata if values.size]
    if not strata:
        return NOTHING
    value = float(statistic(*strata))
    if min(values.size for values in strata) < 2:
        return Estimate(value, math.nan, math.nan)
    how = {"n_resamples": RESAMPLES, "confidence_level": LEVEL, "method": "percentile", "vectorized": True}
    interval = stats.bootstrap(strata, statistic, rng=np.random.default_rng(SEED), **how).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def _mean(*samples: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.mean(np.concatenate(samples, axis), axis)


def _trimmed(*samples: np.ndarray, axis: int = -1) -> np.ndarray:
    from scipy import stats

    return stats.trim_mean(np.concatenate(samples, axis), 0.25, axis)


@lru_cache(maxsize=8)
def _weights(count: int, stratum: int) -> np.ndarray:
    """How often each of `count` seeds is drawn, as a share, (RESAMPLES, count); others for every stratum."""
    rng = np.random.default_rng([SEED, stratum])
    return rng.multinomial(count, np.full(count, 1 / count), RESAMPLES) / count
