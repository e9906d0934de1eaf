"""Look where the path goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_client.mppi.config import CriticWeights
from revnm_client.mppi.rollout import Rollouts

Array32 = NDArray[np.float32]

_STRIDE = 3
_NEAR_M = np.float32(0.3)  # so near, the direction to the target says little


def heading_cost(rollouts: Rollouts, target_m: FloatArray, weights: CriticWeights) -> Array32:
    """Return (K,), the weighted mean of 1 − cos(angle between heading and direction to the target).

    Args:
        rollouts: K rollouts.
        target_m: (2,) on the path, robot frame; nearer than 0.3 m its direction counts ever less.
        weights: Of the critics.
    """
    picked = slice(_STRIDE - 1, None, _STRIDE)
    dx = np.float32(target_m[0]) - rollouts.x_m[:, picked]
    dy = np.float32(target_m[1]) - rollouts.y_m[:, picked]
    distance = np.sqrt(dx * dx + dy * dy)
    ahead = dx * rollouts.cos[:, picked] + dy * rollouts.sin[:, picked]
    off = (distance - ahead) / np.maximum(distance, _NEAR_M)
    cost: Array32 = np.float32(weights.heading) * off.mean(axis=1)
    return cost
