"""Get on along the path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_client.mppi.config import CriticWeights
from revnm_client.mppi.rollout import Rollouts

Array32 = NDArray[np.float32]


def follow_cost(rollouts: Rollouts, target_m: FloatArray, weights: CriticWeights) -> Array32:
    """Return (K,), the weighted distance to the target: half at the end, half on average over the steps.

    The average is what makes the robot hurry: by the end alone, dawdling first costs nothing.

    Args:
        rollouts: K rollouts.
        target_m: (2,) on the path, robot frame.
        weights: Of the critics.
    """
    dx = rollouts.x_m - np.float32(target_m[0])
    dy = rollouts.y_m - np.float32(target_m[1])
    dx *= dx
    dy *= dy
    dx += dy
    distance = np.sqrt(dx, out=dx)
    cost: Array32 = np.float32(0.5 * weights.follow) * (distance[:, -1] + distance.mean(axis=1))
    return cost
