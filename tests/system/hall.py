"""The hall in which the tests drive: a room with one pillar, under a camera that suits the tiny bundle."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2
from revnm_sim.camera import Camera
from revnm_sim.scenario import Scenario
from revnm_sim.world import Bounds, Primitive, Shape, World

ROBOT, CAMERA = "rover", "cam0"

_GRAY = (170, 170, 175)
_WALLS = tuple(
    Primitive(Shape.BOX, (x, y, 0.25), (width, depth, 0.5), 0.0, _GRAY)
    for x, y, width, depth in ((0.0, 2.6, 7.2, 0.2), (0.0, -2.6, 7.2, 0.2), (3.5, 0.0, 0.2, 5.0), (-3.5, 0.0, 0.2, 5.0))
)
_PILLAR = Primitive(Shape.CYLINDER, (0.0, 1.6, 0.3), (0.4, 0.4, 0.6), 0.0, (160, 90, 60))

# The camera hangs above the floor with x to the right and y up in the picture, as the tiny bundle expects.
SCENARIO = Scenario(
    world=World("hall", Bounds(-3.4, -2.5, 3.4, 2.5), (150, 150, 150), (*_WALLS, _PILLAR)),
    camera=Camera(640, 480, math.radians(75.0), (0.0, 0.0, 4.3), math.pi / 2, math.pi / 2),
    start=Pose2(-2.0, -0.6, 0.0),
    goal_m=(1.6, 0.5),
    seed=0,
)


def pixel_of(place_m: tuple[float, float]) -> tuple[float, float]:
    """Return where the camera sees a place on the floor."""
    (u, v), _ = SCENARIO.camera.project(np.array([*place_m, 0.0]))
    return float(u), float(v)
