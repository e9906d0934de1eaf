"""The expert: the ceiling of what waypoints can achieve with this controller."""

from __future__ import annotations

from revnm_client.geometry import FloatArray
from revnm_sim.bench.methods.method import SPACING_M, WAYPOINTS, MethodContext
from revnm_sim.expert.planner import UnreachableError


class ExpertMethod:
    """Knows the true pose, goal and map."""

    def __init__(self, context: MethodContext) -> None:
        self._context = context

    def look(self) -> None:
        """Do nothing: the truth needs no picture."""

    def waypoints(self) -> FloatArray | None:
        """Return points on the expert's way; None where there is none."""
        pose = self._context.simulation.true_pose
        try:
            return self._context.field.waypoints(pose, count=WAYPOINTS, spacing_m=SPACING_M)
        except UnreachableError:
            return None
