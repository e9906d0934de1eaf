"""Keep clear of obstacles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.mppi.config import CriticWeights

Array32 = NDArray[np.float32]

_NOISE_M = np.float32(0.01)


def obstacle_cost(clearance_m: Array32, now_m: float, weights: CriticWeights) -> Array32:
    """Return (K,): one large cost for a collision, a steep one for scraping by, a gentle one for being near.

    A robot that stands too near already (the circles are larger than its body) collides only by going nearer:
    else every sample would collide and none would lead out.

    Args:
        clearance_m: (K, T), of the covering circles.
        now_m: Clearance where the robot stands.
        weights: Of the critics.
    """
    floor = np.float32(min(0.0, now_m)) - _NOISE_M
    collides = clearance_m.min(axis=1) < floor
    cost: Array32 = np.where(collides, np.float32(weights.collision), np.float32(0.0))
    cost += np.float32(weights.critical) * _missing(clearance_m, weights.critical_margin_m)
    steps = clearance_m.shape[1]
    cost += np.float32(weights.repulsion / steps) * _missing(clearance_m, weights.repulsion_margin_m)
    return cost


def _missing(clearance_m: Array32, margin_m: float) -> Array32:
    """Return (K,), what the steps lack of the margin, summed."""
    # clip, because numpy is slow at the minimum of an array and a number
    kept: Array32 = clearance_m.clip(-np.inf, margin_m).sum(axis=1)
    return np.float32(margin_m * clearance_m.shape[1]) - kept
