"""What to do while the camera's calibration is unknown: drive carefully where the LiDAR sees room, and turn.

A straight track does not tell a long focal length from a flat pitch; a track that turns does. So the robot weaves:
half a metre of arc to one side, the next to the other, round about towards the goal. Imports numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from revnm_client.geometry import FloatArray, Pose2, wrap_angle

_SLACK_M = 0.01
_DIRECTION_PRICE = 2.0  # of setting out backwards; ahead costs nothing
_GOAL_PRICE = 1.0  # of facing away from the goal at the arc's end
_CLEARANCE_PRICE = 1.5  # of an arc that only just has room
_SHORT_PRICE = 0.4
_OTHER_SIDE_PRICE = 0.6
_TURNING_RAD = 0.05


@dataclass(frozen=True, slots=True)
class StepSettings:
    """How to drive without a map.

    Attributes:
        waypoints: How many waypoints, H.
        arc_m: Length of an arc, and how far the robot goes before it turns the other way.
        short_m: Length where that has no room.
        turn_rad: Change of heading over an arc.
        least_m: Nothing may be nearer to the robot's middle, unless it is so already.
        clear_m: More room than this is worth nothing.
        body_m: Points nearer than this are the robot itself.
        longest_m: Having driven so far without a calibration, give up.
    """

    waypoints: int = 5
    arc_m: float = 0.5
    short_m: float = 0.3
    turn_rad: float = 0.6
    least_m: float = 0.27
    clear_m: float = 0.40
    body_m: float = 0.12
    longest_m: float = 4.0


@dataclass(frozen=True, slots=True)
class FirstSteps:
    """What to do next.

    Attributes:
        waypoints_m: (H, 2) along an arc, at equal lengths, metres, frame of the robot; None if the robot shall stand.
        reason: Why it shall; empty otherwise.
    """

    waypoints_m: FloatArray | None
    reason: str


class _Arc(NamedTuple):
    """Set out in a direction (left positive), and turn by so much over a length."""

    direction_rad: float
    turn_rad: float
    length_m: float

    def points(self, count: int) -> FloatArray:
        """Return points (count, 2) at equal lengths; the robot's place is not among them."""
        share = np.arange(1.0, count + 1.0) / count
        # A chord of a circle: of length 2 r sin(turn / 2), in the direction of half the turn.
        radius, turned = self.length_m / self.turn_rad, share * self.turn_rad
        chord, heading = 2.0 * radius * np.sin(turned / 2.0), self.direction_rad + turned / 2.0
        return np.stack([chord * np.cos(heading), chord * np.sin(heading)], axis=1)


def first_steps(
    scan_m: FloatArray | None, goal_bearing_rad: float, driven: Sequence[Pose2], settings: StepSettings
) -> FirstSteps:
    """Return a gentle arc into free space, about towards the goal.

    Args:
        scan_m: (M, 2) what the LiDAR hit, metres, frame of the robot; None if there is no LiDAR: then nothing is known
            to be in the way, and the robot's own safety is all there is.
        goal_bearing_rad: About where the goal is, from the robot's forward axis, left positive.
        driven: Odometry from the beginning to now, oldest first; may be empty.
        settings: How to drive.
    """
    track = np.array(driven).reshape(-1, 3)
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track[:, :2], axis=0).T))])
    if lengths[-1] >= settings.longest_m:
        return FirstSteps(None, f"no calibration after {lengths[-1]:.1f} m of driving")
    side = _side_begun(track, lengths, settings)
    hits = np.empty((0, 2)) if scan_m is None else scan_m[np.hypot(*scan_m.T) > settings.body_m]
    best, least = None, np.inf
    for arc in _arcs(goal_bearing_rad, settings):
        price = _price(arc, hits, goal_bearing_rad, side, settings)
        if price < least:
            best, least = arc, price
    if best is None:
        return FirstSteps(None, f"no room for {settings.short_m:.1f} m in any direction")
    return FirstSteps(best.points(settings.waypoints), "")


def _side_begun(track: FloatArray, lengths_m: FloatArray, settings: StepSettings) -> float:
    """Return to which side, +1 left, −1 right, the robot has turned on the arc that it is on; 0 if it begins one."""
    if len(track) < 2:
        return 0.0
    begun_m = np.floor(lengths_m[-1] / settings.arc_m + 1e-9) * settings.arc_m
    turned = wrap_angle(float(track[-1, 2] - np.interp(begun_m, lengths_m, np.unwrap(track[:, 2]))))
    return float(np.sign(turned)) if abs(turned) > _TURNING_RAD else 0.0


def _arcs(goal_bearing_rad: float, settings: StepSettings) -> list[_Arc]:
    """Return what could be driven; of equals the first is taken: ahead, long, to the goal's side."""
    side = 1.0 if goal_bearing_rad >= 0.0 else -1.0
    return [
        _Arc(side * eighths * np.pi / 4.0, side * turn * settings.turn_rad * length / settings.arc_m, length)
        for eighths in (0, 1, -1, 2, -2, 3, -3, 4)
        for length in (settings.arc_m, settings.short_m)
        for turn in (1.0, -1.0)
    ]


def _price(arc: _Arc, hits_m: FloatArray, goal_bearing_rad: float, side: float, settings: StepSettings) -> float:
    """Return how bad an arc is; inf if the robot would come too near to something on it."""
    clearance = settings.clear_m
    if len(hits_m):
        places = np.concatenate([np.zeros((1, 2)), arc.points(2 * settings.waypoints)])
        room = np.hypot(*(places[:, None] - hits_m).transpose(2, 0, 1)).min(axis=1)  # at each place
        # A robot that stands too near already may go, if that leads it out.
        if room[1:].min() < min(settings.least_m, room[0]) - _SLACK_M or room[-1] < settings.least_m:
            return np.inf
        clearance = min(clearance, float(room[1:].min()))
    facing = abs(wrap_angle(goal_bearing_rad - arc.direction_rad - arc.turn_rad)) / np.pi
    price = _GOAL_PRICE * facing + _DIRECTION_PRICE * abs(arc.direction_rad) / np.pi
    price += _CLEARANCE_PRICE * (settings.clear_m - clearance) / (settings.clear_m - settings.least_m)
    price += _SHORT_PRICE * (arc.length_m < settings.arc_m)
    return float(price + _OTHER_SIDE_PRICE * (side * arc.turn_rad < 0.0))
