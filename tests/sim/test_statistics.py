"""Intervals and p-values by hand and against scipy."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from revnm_sim.bench.statistics import bootstrap_mean, mcnemar_p


def test_interval_of_few_clusters_is_that_of_all_draws() -> None:
    # Five clusters of two trials with means 0, 0.5, 0.5, 0.5 and 1: 3125 equally likely draws.
    values = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    means = [np.mean(draw) for draw in product([0.0, 0.5, 0.5, 0.5, 1.0], repeat=5)]
    low, high = np.percentile(means, (2.5, 97.5))
    assert bootstrap_mean(values, [n // 2 for n in range(10)]) == pytest.approx((low, high))


def test_clusters_that_agree_within_widen_the_interval() -> None:
    rng = np.random.default_rng(0)
    values = np.repeat(rng.integers(0, 2, 50), 5).astype(float)
    by_trial = bootstrap_mean(values, range(250))
    by_pair = bootstrap_mean(values, [trial // 5 for trial in range(250)])
    # Normal theory: half widths 1.96 · σ / √n with n = 250 and 50.
    sigma = values.std()
    assert by_trial.high - by_trial.low == pytest.approx(2 * 1.96 * sigma / 250**0.5, rel=0.1)
    assert by_pair.high - by_pair.low == pytest.approx(2 * 1.96 * sigma / 50**0.5, rel=0.1)
    assert bootstrap_mean(values, range(250)) == by_trial


def test_clusters_of_unequal_size_weigh_by_their_trials() -> None:
    assert bootstrap_mean(np.array([1.0, 1.0, 1.0]), ["a", "a", "b"]) == (1.0, 1.0)
    low, high = bootstrap_mean(np.array([1.0, 1.0, 1.0, 0.0]), ["a", "a", "a", "b"])
    assert (low, high) == (0.0, 1.0)


def test_mcnemar_by_hand() -> None:
    assert mcnemar_p(0, 0) == 1.0
    assert mcnemar_p(0, 5) == pytest.approx(2 / 2**5)
    assert mcnemar_p(5, 0) == pytest.approx(2 / 2**5)
    # 1 of 6: (1 + 6) / 64 on either side.
    assert mcnemar_p(1, 5) == pytest.approx(2 * 7 / 64)
