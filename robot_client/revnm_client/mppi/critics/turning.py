"""Do not wobble."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.mppi.config import CriticWeights
from revnm_client.mppi.rollout import Rollouts

Array32 = NDArray[np.float32]


def turning_cost(rollouts: Rollouts, weights: CriticWeights) -> Array32:
    """Return (K,), the weighted mean square of the turning rate."""
    cost: Array32 = np.float32(weights.turning) * np.square(rollouts.w_radps).mean(axis=1)
    return cost
