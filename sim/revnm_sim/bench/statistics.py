"""How sure the figures are: cluster bootstrap, and McNemar's test for two methods that met the same trials.

Trials of one cluster (a pair in front of a camera, or a pair in front of all its cameras) are not independent, so
clusters are drawn, not trials.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from revnm_client.geometry import FloatArray

_DRAWS = 10_000
_SEED = 20_260


class Interval(NamedTuple):
    """A 95 % interval."""

    low: float
    high: float


def bootstrap_mean(values: FloatArray, clusters: Sequence[Hashable]) -> Interval:
    """Return the percentile interval of the mean of values (M,), drawing whole clusters with replacement.

    The draws are the same every time. For paired methods, give the differences.

    Source: Cameron, Gelbach and Miller, 2008, doi:10.1162/rest.90.3.414 (pairs cluster bootstrap).

    Args:
        values: One per trial.
        clusters: Which cluster each trial belongs to.
    """
    numbers = {cluster: number for number, cluster in enumerate(dict.fromkeys(clusters))}
    which = np.array([numbers[cluster] for cluster in clusters])
    sums = np.bincount(which, weights=values)
    sizes = np.bincount(which)
    rng = np.random.default_rng(_SEED)
    drawn = rng.multinomial(len(sums), np.full(len(sums), 1.0 / len(sums)), size=_DRAWS)  # (draws, clusters)
    low, high = np.percentile((drawn @ sums) / (drawn @ sizes), (2.5, 97.5))
    return Interval(float(low), float(high))


def rate_interval(values: FloatArray, clusters: Sequence[Hashable]) -> Interval:
    """Return the interval of a rate: :func:`bootstrap_mean` of values (M,) that are 0 or 1.

    Where all are the same, a bootstrap knows no doubt: then it is Clopper and Pearson's of as many clusters.
    """
    if 0.0 < float(np.mean(values)) < 1.0:
        return bootstrap_mean(values, clusters)
    count = len(set(clusters))
    exact = binomtest(count if values[0] else 0, count).proportion_ci(confidence_level=0.95, method="exact")
    return Interval(float(exact.low), float(exact.high))


def mcnemar_p(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p of McNemar's test: of the trials in which just one of two methods succeeded.

    Source: McNemar, 1947, doi:10.1007/BF02295996, with the exact binomial distribution. Repeats and cameras of a
    pair are counted as independent, so p is too small; read it beside the bootstrap intervals of the difference.

    Args:
        only_first: Trials in which the first succeeded and the second did not.
        only_second: The reverse.
    """
    discordant = only_first + only_second
    return float(binomtest(only_first, discordant).pvalue) if discordant else 1.0
