"""IBVS, the paper's baseline: a shortest way over the floor in the picture, followed by image angles.

The paper segments the floor with SAM 3. Here the simulator gives the exact floor, and rugs count as floor, so this is
an upper bound of that baseline. Its margin is a number of pixels, whatever they are in metres, and an angle in the
picture is taken for an angle on the floor: both are exact under a camera that looks straight down, and wrong under an
oblique one, as the paper says. The search finds the shortest way, as A* does, but is not bound to a grid's eight
directions. The robot's pose in the picture is the one that all methods get
(:mod:`revnm_sim.bench.methods.pose`).
"""

from __future__ import annotations

import cv2
import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.frame import RobotSighting
from revnm_sim.bench.image_plan import BoolArray, ImageGrid, ImageRoute, look_ahead, see_floor
from revnm_sim.bench.methods.method import SPACING_M, WAYPOINTS, MethodContext
from revnm_sim.bench.methods.pose import KeptSightings
from revnm_sim.camera import Camera

_MARGIN = 8.0 / 640.0  # of the picture's width
_REACH = 40.0 / 640.0


class IbvsMethod:
    """Plans and steers in pixels; knows the tag's size, and no camera."""

    def __init__(self, context: MethodContext) -> None:
        """Segment the floor, which does not change in a trial."""
        scenario = context.scenario
        self._simulation, self._tag_m = context.simulation, scenario.robot.tag_m
        self._sightings = KeptSightings(scenario, context.simulation)
        grid = ImageGrid(scenario.camera)
        self._free = free_by_pixels(see_floor(scenario.world, scenario.camera, grid), _MARGIN * grid.shape[1])
        self._route = ImageRoute(grid, goal_pixel(scenario.camera, scenario.goal_m))
        self._reach_px = _REACH * scenario.camera.width_px

    def look(self) -> None:
        """Do nothing: the floor is segmented once."""

    def waypoints(self) -> FloatArray | None:
        """Return points on the way in the picture, brought to the floor by image angles; None before a sighting."""
        now_ns = self._simulation.time_ns
        sighting = self._sightings.sighting(now_ns)
        if sighting is None:
            return None
        path = self._route.path(now_ns, sighting.pixel, lambda: self._free, reach_px=self._reach_px)
        scale = heading_scale(sighting, self._tag_m)
        pixels = look_ahead(path, sighting.pixel, spacing=SPACING_M * scale, count=WAYPOINTS)
        return by_image_angles(sighting, pixels, px_per_m=scale)


def goal_pixel(camera: Camera, goal_m: tuple[float, float]) -> FloatArray:
    """Return the goal's pixel (2,), as an operator would click it."""
    return camera.project(np.array([*goal_m, 0.0]))[0]


def free_by_pixels(floor: BoolArray, margin: float) -> BoolArray:
    """Return which cells (h, w) of the floor are farther than a margin, cells, from all that is not floor.

    What lies beyond the picture's edge is taken for floor.
    """
    distance = cv2.distanceTransform(floor.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance > margin)


def heading_scale(sighting: RobotSighting, tag_m: float) -> float:
    """Return the scale along the robot's heading, pixels per metre, from the apparent length of its tag."""
    front, rear = sighting.corners[:2].mean(axis=0), sighting.corners[2:].mean(axis=0)
    return float(np.linalg.norm(front - rear)) / tag_m


def by_image_angles(sighting: RobotSighting, pixels: FloatArray, *, px_per_m: float) -> FloatArray:
    """Return pixels (M, 2) as metres (M, 2) in the robot's frame, as if the camera looked straight down.

    The bearing is the angle in the picture from the robot's heading, the length that in pixels by one scale.
    """
    step = (pixels - sighting.pixel) / px_per_m
    (along_u, along_v), (u, v) = sighting.heading, step.T
    return np.stack([along_u * u + along_v * v, along_v * u - along_u * v], axis=1)  # v down: left is (v, −u)
