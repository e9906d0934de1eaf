"""Where to look for the goal when a robot that the camera does not see should have reached it by its odometry.

The operator clicked on floor that the camera sees, so a robot that stood there would be seen: it stands somewhere
beside. It goes round the place in growing rings until the camera sees it, which tells where it is. Imports numpy only.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray

TRUSTED_M = 2.0  # a robot that went no farther since it was seen is where its odometry has it
_REACHED_M = 0.25
_STUCK_NS = 8_000_000_000  # without coming nearer, turning about included: the place cannot be reached
_CLOSER_M = 0.05
_RINGS_M = (0.6, 1.2)
_SPACING_M = 0.6


def _rings() -> FloatArray:
    """Return the places (P, 2) of the rings, relative to the goal, each ring begun where the last one ended."""
    places = []
    for radius in _RINGS_M:
        count = math.ceil(math.tau * radius / _SPACING_M)
        angles = math.tau * np.arange(count) / count
        places.append(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    return np.concatenate(places)


class GoalSearch:
    """Remembers where a robot has looked for one goal."""

    def __init__(self) -> None:
        self._places = _rings()
        self._goal_id = ""
        self._next = -1  # of the places; -1 is the goal itself
        self._least_m, self._since_ns = math.inf, 0

    def target_m(
        self, goal_id: str, goal_m: FloatArray, robot_m: FloatArray, *, hidden_m: float, stamp_ns: int
    ) -> FloatArray | None:
        """Return where to go now.

        Args:
            goal_id: Of the goal; a new one begins anew.
            goal_m: (2,) where it is by the camera, metres, frame of the map.
            robot_m: (2,) where the robot is by its odometry.
            hidden_m: How far it went since the camera saw it last.
            stamp_ns: Now.

        Returns:
            (2,) the goal, or where to look for it; None when all places were tried.
        """
        if goal_id != self._goal_id or hidden_m <= TRUSTED_M:
            self._goal_id, self._next = goal_id, -1
            self._restart()
        target = self._target(goal_m)
        if hidden_m <= TRUSTED_M:
            return target
        while target is not None and self._done(math.hypot(*(target - robot_m)), stamp_ns):
            self._next += 1
            self._restart()
            target = self._target(goal_m)
        return target

    @property
    def searching(self) -> bool:
        """Whether the goal itself was reached by odometry alone."""
        return self._next >= 0

    def _target(self, goal_m: FloatArray) -> FloatArray | None:
        if self._next < 0:
            return goal_m
        return goal_m + self._places[self._next] if self._next < len(self._places) else None

    def _restart(self) -> None:
        self._least_m = math.inf

    def _done(self, distance_m: float, stamp_ns: int) -> bool:
        """Tell whether the robot has reached a place, or cannot."""
        if distance_m <= _REACHED_M:
            return True
        if self._next < 0:
            return False  # the goal itself is never given up: what bars it may move
        if distance_m < self._least_m - _CLOSER_M:
            self._least_m, self._since_ns = distance_m, stamp_ns
        return stamp_ns - self._since_ns > _STUCK_NS
