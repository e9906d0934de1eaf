"""IBVS with the scale that the robot's tag shows: margins and waypoints in metres, still without a calibration.

Like :mod:`revnm_sim.bench.methods.ibvs`, with the same exact floor, but the two faults that the paper names are mended.
The margin is the robot's radius on every row of the picture, as the tag's size by row shows it, and waypoints come from
the homography of the tag instead of image angles. The tag lies on the robot's top plate: a point at its height is
taken to be seen as many pixels above its floor as that height would be wide there. That is exact where the view is
level, and some centimetres wrong where it is steep.
"""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.mapping.tag_plane import TagPlane
from revnm_sim.bench.image_plan import ImageGrid, ImageRoute, look_ahead, see_floor
from revnm_sim.bench.methods.ibvs import goal_pixel
from revnm_sim.bench.methods.method import SPACING_M, WAYPOINTS, MethodContext
from revnm_sim.bench.methods.pose import KeptSightings
from revnm_sim.bench.row_scale import RowScale, free_by_metres
from revnm_sim.expert.planner import INSCRIBED_M

_RADIUS_M = INSCRIBED_M + 0.03
_REACH_M = 0.5


class IbvsScaleMethod:
    """Plans in pixels and steers in metres; knows the tag's size and height, and no camera."""

    def __init__(self, context: MethodContext) -> None:
        """Segment the floor, which does not change in a trial."""
        scenario = context.scenario
        self._simulation, self._robot = context.simulation, scenario.robot
        self._sightings = KeptSightings(scenario, context.simulation)
        self._grid = ImageGrid(scenario.camera)
        self._floor = see_floor(scenario.world, scenario.camera, self._grid)
        self._route = ImageRoute(self._grid, goal_pixel(scenario.camera, scenario.goal_m))
        self._scale = RowScale(tag_height_m=scenario.robot.top_m)

    def look(self) -> None:
        """Do nothing: the floor is segmented once."""

    def waypoints(self) -> FloatArray | None:
        """Return points on the way in the picture, brought to the floor by the tag's homography.

        None before a sighting, and where no point of the way lies on the tag's plane.
        """
        now_ns = self._simulation.time_ns
        sighting = self._sightings.sighting(now_ns)
        if sighting is None:
            return None
        plane = TagPlane(sighting, tag_size_m=self._robot.tag_m)
        self._scale.add(plane)
        foot = self._scale.foot(sighting.pixel)
        reach_px = _REACH_M * float(self._scale.across(foot[1]))
        path = self._route.path(
            now_ns,
            foot,
            lambda: free_by_metres(self._floor, self._grid, self._scale, radius_m=_RADIUS_M),
            reach_px=reach_px,
        )
        points, valid = plane.locate(self._scale.lift(path))
        if valid.sum() < 2:
            return None
        return look_ahead(points[valid], np.zeros(2), spacing=SPACING_M, count=WAYPOINTS)
