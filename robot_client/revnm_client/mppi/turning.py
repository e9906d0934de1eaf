"""Turn on the spot first when the path leads away sideways or backwards.

A robot that only drives forwards, with a turning circle of 0.7 m at top speed, would leave the path in a wide
arc. The idea is Nav2's RotationShimController.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_client.messages import Velocity
from revnm_client.mppi.config import MppiConfig
from revnm_client.mppi.distance_field import DistanceField
from revnm_client.mppi.reference_path import ReferencePath

_LOOK_AHEAD_M = 0.5
_CHANGES_SIDES_RAD = 0.7  # what lies so near to straight behind may be on the other side in the next tick
_NEAR_M = 0.1  # so near, the bearing means nothing


class TurnFirst:
    """Decides whether to turn on the spot; remembers that it does, and which way."""

    def __init__(self, config: MppiConfig) -> None:
        self._config = config
        self._direction = 0.0

    def reset(self) -> None:
        """Forget a turn that was under way."""
        self._direction = 0.0

    def command(self, path: ReferencePath, field: DistanceField, now: Velocity) -> Velocity | None:
        """Return the velocity of the turn, or None when there is nothing to turn for, or no room to.

        Args:
            path: What lies ahead.
            field: Obstacles.
            now: Velocity of the robot.
        """
        ahead = path.at(_LOOK_AHEAD_M)
        bearing = math.atan2(ahead[1], ahead[0])
        limit = self._config.turned_rad if self._direction else self._config.turn_first_rad
        if abs(bearing) < limit or math.hypot(*ahead) < _NEAR_M or not self._is_free(ahead, field):
            self._direction = 0.0
            return None
        self._direction = self._choose(bearing, field)
        if not self._direction:
            return None
        step = self._config.max_alpha_radps2 * self._config.dt_s
        wanted = self._direction * self._config.max_w_radps
        return Velocity(0.0, min(max(wanted, now.w_radps - step), now.w_radps + step))

    def _is_free(self, ahead: FloatArray, field: DistanceField) -> bool:
        """Whether the robot could drive straight to the point once it has turned, or at least get no nearer."""
        fraction = np.linspace(0.0, 1.0, 6, dtype=np.float32)
        distance = field.at(fraction * np.float32(ahead[0]), fraction * np.float32(ahead[1]))
        return bool(distance[1:].min() > min(self._config.footprint.width_m / 2.0, float(distance[0])))

    def _choose(self, bearing: float, field: DistanceField) -> float:
        """Return the turn's sign: as before, else the short way, else the long; 0 if neither is free.

        As before not if that has become far longer, because the path now leads elsewhere: what lies about straight
        behind changes sides with every tick.
        """
        short = math.copysign(1.0, bearing)
        longer = self._direction == -short and abs(bearing) < math.pi - _CHANGES_SIDES_RAD
        first = short if longer else self._direction or short
        for direction in (first, -first):
            sweep = bearing if direction == short else bearing - math.copysign(math.tau, bearing)
            if self._may_sweep(sweep, field):
                return direction
        return 0.0

    def _may_sweep(self, angle_rad: float, field: DistanceField) -> bool:
        """Whether the body can turn by the angle; the covering circles reach farther out than its corners do."""
        footprint = self._config.footprint
        middle = np.zeros(1, dtype=np.float32)
        cell_m = self._config.field_resolution_m
        if float(field.at(middle, middle)[0]) > footprint.circumscribed_m + cell_m / 2.0:
            return True
        angles = np.linspace(0.0, angle_rad, 13, dtype=np.float32)
        ahead = np.array(footprint.circles_x_m, dtype=np.float32)[:, None]
        distance = field.at(ahead * np.cos(angles), ahead * np.sin(angles)).min(axis=0)
        distance -= np.float32(footprint.circle_radius_m)
        return bool(distance.min() >= min(0.0, float(distance[0])))
