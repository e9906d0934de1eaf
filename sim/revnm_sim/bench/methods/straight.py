"""Straight to the goal: shows how much the controller solves alone."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_sim.bench.methods.method import SPACING_M, WAYPOINTS, MethodContext


class StraightMethod:
    """Knows the true pose and goal, and no obstacle."""

    def __init__(self, context: MethodContext) -> None:
        self._context = context

    def look(self) -> None:
        """Do nothing: the truth needs no picture."""

    def waypoints(self) -> FloatArray | None:
        """Return points on the straight way to the goal; those beyond it are at the goal."""
        pose = self._context.simulation.true_pose
        goal = pose.inverse().apply(np.array(self._context.scenario.goal_m))
        distance = max(float(np.linalg.norm(goal)), 1e-9)
        steps = np.minimum(SPACING_M * np.arange(1, WAYPOINTS + 1), distance)
        return np.asarray(goal / distance * steps[:, None])
