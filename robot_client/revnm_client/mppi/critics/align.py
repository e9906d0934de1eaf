"""Stay on the path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_client.mppi.config import CriticWeights
from revnm_client.mppi.rollout import Rollouts

Array32 = NDArray[np.float32]

_STRIDE = 3  # every third step is enough: 15 cm at top speed


def align_cost(rollouts: Rollouts, path_m: FloatArray, weights: CriticWeights) -> Array32:
    """Return (K,), the weighted mean distance of a rollout to the nearest path points.

    Args:
        rollouts: K rollouts.
        path_m: (P, 2), P ≥ 1, robot frame, closely spaced.
        weights: Of the critics.
    """
    x = rollouts.x_m[:, _STRIDE - 1 :: _STRIDE].copy(order="K")  # in one piece, for the loop
    y = rollouts.y_m[:, _STRIDE - 1 :: _STRIDE].copy(order="K")
    nearest = np.full_like(x, np.inf)
    for px, py in path_m.astype(np.float32):
        dx = x - px
        dy = y - py
        dx *= dx
        dy *= dy
        dx += dy
        np.minimum(nearest, dx, out=nearest)
    np.sqrt(nearest, out=nearest)
    cost: Array32 = np.float32(weights.align) * nearest.mean(axis=1)
    return cost
