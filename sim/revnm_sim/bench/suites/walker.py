"""Somebody who crosses the robot's way, with a little caution: a cylinder that stops rather than walk into the robot.

The walker keeps to a straight line at an even speed. It stands still while its next 0.2 s would bring it nearer than
0.1 m to the robot's rectangle as that stands now; it does not foresee where the robot drives, does not dodge, and does
not mind being near while it walks away. Having waited for 2 s in one go it turns back. So it never runs into a robot
that stands, but cuts in closely before one that drives, which has to see to itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.braking import rectangle_distance
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.mppi import Footprint
from revnm_sim.world import Primitive, Shape

_FORESIGHT_S = 0.2
_PATIENCE_S = 2.0
_CAUTION_M = 0.1
_HEIGHT_M = 1.7
_COLOUR = (70, 90, 160)


@dataclass(frozen=True, slots=True)
class Walk:
    """A straight way of a walker.

    Attributes:
        from_m: (x, y) of its beginning, world frame.
        to_m: Its end, where the walker remains.
        speed_mps: While walking.
        begin_s: When it sets out.
        radius_m: Of the walker.
    """

    from_m: tuple[float, float]
    to_m: tuple[float, float]
    speed_mps: float
    begin_s: float
    radius_m: float = 0.2

    @property
    def body(self) -> Primitive:
        """The walker at the beginning of the way."""
        size = (2.0 * self.radius_m, 2.0 * self.radius_m, _HEIGHT_M)
        return Primitive(Shape.CYLINDER, (*self.from_m, _HEIGHT_M / 2.0), size, 0.0, _COLOUR)


class Walker:
    """A walker on its walk.

    Attributes:
        place_m: (2,) where it is, world frame.
    """

    def __init__(self, walk: Walk) -> None:
        self.place_m: FloatArray = np.array(walk.from_m)
        self._walk = walk
        self._target_m: FloatArray = np.array(walk.to_m)
        self._waited_s = 0.0
        self._time_s = 0.0

    def advance(self, dt_s: float, robot: Pose2, footprint: Footprint) -> None:
        """Walk on for a time, or wait.

        Args:
            dt_s: How long.
            robot: ``world_from_robot`` now.
            footprint: Of the robot.
        """
        self._time_s += dt_s
        left_m = self._target_m - self.place_m
        length_m = math.hypot(*left_m)
        if self._time_s < self._walk.begin_s or length_m == 0.0:
            return
        step_m = left_m / length_m
        if self._minds(step_m, robot, footprint):
            self._wait(dt_s)
        else:
            self._waited_s = 0.0
            self.place_m = self.place_m + step_m * min(self._walk.speed_mps * dt_s, length_m)

    def _minds(self, direction: FloatArray, robot: Pose2, footprint: Footprint) -> bool:
        """Tell whether the next steps lead nearer to the robot than the walker likes."""
        reach_m = np.linspace(0.0, self._walk.speed_mps * _FORESIGHT_S, 6)
        places = self.place_m + reach_m[:, None] * direction  # (6, 2)
        gaps_m = rectangle_distance(places, np.array([robot]), footprint)[0] - self._walk.radius_m
        return bool(gaps_m[1:].min() < min(_CAUTION_M, float(gaps_m[0]) - 1e-9))

    def _wait(self, dt_s: float) -> None:
        self._waited_s += dt_s
        if self._waited_s >= _PATIENCE_S:
            self._target_m = np.array(self._walk.from_m)
