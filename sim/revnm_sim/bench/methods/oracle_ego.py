"""ReVNM with the true ego depth in place of the imagined one: the most that exo2ego could give (paper, section V-A)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revnm_server.networks.bundle import Bundle
from revnm_server.observation import Image32, normalise_ego_depth
from revnm_server.ports import EgoRequest
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.bench.methods.revnm import RevnmMethod
from revnm_sim.rays.raycast import cast_depth, ego_camera
from revnm_sim.world import primitive_arrays


class TrueEgo:
    """Exact ego depth of the one simulated robot, wherever the camera last saw it."""

    def __init__(self, bundle: Bundle, context: MethodContext) -> None:
        self._spec, self._simulation = bundle.spec, context.simulation
        self._arrays = primitive_arrays(context.scenario.world.primitives)

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        """Return (R, ego_px, ego_px) float32 in [−1, 1]."""
        side = self._spec.ego_px
        camera = ego_camera(self._simulation.true_pose, self._spec)
        view = normalise_ego_depth(cast_depth(self._arrays, camera, (side, side)), self._spec)
        return np.broadcast_to(view, (len(requests), side, side))


class OracleEgoMethod(RevnmMethod):
    """The pipeline with :class:`TrueEgo`."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context, TrueEgo)
