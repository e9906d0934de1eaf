"""The navigation policies: the paper's (section III-B), which leads robots, and one that advises the map's planner."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32
from revnm_server.stages.feature_memory import FeatureMemory

if TYPE_CHECKING:
    from revnm_server.networks.bundle import Bundle
    from revnm_server.ports import BeliefRequest, PlanRequest


class OnnxPolicy:
    """A planner that is a bundle's policy network, one batch over all robots of one camera."""

    def __init__(self, bundle: Bundle) -> None:
        """Take the network from the bundle."""
        self._model = bundle.policy
        self._waypoints = bundle.spec.waypoints
        self._features = None if bundle.encoder is None else FeatureMemory(bundle.encoder, bundle.spec)

    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        """Return (R, H, 2), metres, in each robot's frame at its sighting's stamp; R may be 0."""
        if not requests:
            return np.zeros((0, self._waypoints, 2))

        def batch(part: Callable[[PlanRequest], FloatArray | Image32]) -> Image32:
            return np.stack([part(request) for request in requests]).astype(np.float32)

        if self._features is not None:
            exo, ego = self._features.recall(requests)  # (R, N, T, d)
        else:
            exo = batch(lambda request: request.exo[:, None])  # (R, N, 1, h, w)
            ego = batch(lambda request: request.ego[:, None])  # (R, N, 1, px, px)
        outputs = self._model.run(
            exo=exo,
            ego=ego,
            robot=batch(lambda request: request.pose.p_rob),  # (R, 2)
            heading=batch(lambda request: request.pose.q_rel),  # (R, 2)
            goal=batch(lambda request: request.goal),  # (R, 2)
        )
        return np.asarray(outputs["waypoints"], dtype=np.float64)


class OnnxFloorPolicy:
    """A bundle's policy that sees the map, one batch over all robots; see :class:`revnm_server.ports.FloorPolicy`."""

    def __init__(self, bundle: Bundle) -> None:
        """Take the network from the bundle."""
        self._model = bundle.policy

    def believe(self, requests: Sequence[BeliefRequest]) -> Image32:
        """Return the probabilities (R, side, side) that something stands in a window's cells; R is at least 1."""
        occupied: Image32 = self._model.run(
            map=np.stack([request.window for request in requests]),
            way=np.stack([request.way for request in requests]).astype(np.float32),
            goal=np.stack([request.goal for request in requests]).astype(np.float32),
            ego=np.stack([request.ego for request in requests])[:, None],
        )["occupied"]
        return occupied
