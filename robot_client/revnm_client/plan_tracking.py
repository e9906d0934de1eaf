"""Where the robot was, and where the plan lies now.

A plan is true at the moment its picture was taken. Odometry carries it from there to the present, so that the
delay of network and inference does not shift it.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray, Pose2, interpolate, wrap_angle
from revnm_client.messages import STANDSTILL, Odometry, Plan, Velocity

_KEEP_NS = 3_000_000_000
_BEYOND_NS = 100_000_000
_JUMP_M = 0.5
_JUMP_SPEED_MPS = 3.0
_JUMP_RAD = 1.0
_JUMP_RATE_RADPS = 4.0
_RESTART_NS = 1_000_000_000


class OdometryBuffer:
    """The last three seconds of odometry; stamps in the robot's clock."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._items: list[Odometry] = []

    def add(self, odometry: Odometry) -> bool:
        """Keep a measurement; one that is no newer than the last is ignored.

        Returns:
            False if the odometry frame began anew: the pose jumped (the base restarted), or the stamps went
            back by more than a second. The past is forgotten; what was placed with it must be forgotten too.
        """
        if not self._items:
            self._append(odometry)
            return True
        last = self._items[-1]
        elapsed_ns = odometry.stamp_ns - last.stamp_ns
        if -_RESTART_NS <= elapsed_ns <= 0:
            return True
        continues = elapsed_ns > 0 and not _jumped(last, odometry)
        if not continues:
            self._stamps.clear()
            self._items.clear()
        self._append(odometry)
        return continues

    def at(self, stamp_ns: int) -> Pose2 | None:
        """Return ``odom_from_robot`` at a time, or None more than 100 ms outside of what is known.

        Between measurements it is interpolated, after the last one carried on with its velocity.
        """
        if not self._items:
            return None
        after = bisect.bisect_left(self._stamps, stamp_ns)
        if after == 0:
            return self._items[0].odom_from_robot if self._stamps[0] - stamp_ns <= _BEYOND_NS else None
        if after == len(self._items):
            return self._beyond(stamp_ns)
        a, b = self._stamps[after - 1], self._stamps[after]
        poses = self._items[after - 1].odom_from_robot, self._items[after].odom_from_robot
        return interpolate(*poses, (stamp_ns - a) / (b - a))

    def latest(self, now_ns: int) -> Pose2 | None:
        """Return the pose now: the last one carried on for at most 100 ms, or the first where all are newer.

        None if there is none.
        """
        if not self._items:
            return None
        return self.at(min(max(now_ns, self._stamps[0]), self._stamps[-1] + _BEYOND_NS))

    @property
    def newest_ns(self) -> int:
        """The newest stamp; call it after the first measurement."""
        return self._stamps[-1]

    @property
    def velocity(self) -> Velocity:
        """The last measured velocity; standstill before the first."""
        return self._items[-1].velocity if self._items else STANDSTILL

    def _append(self, odometry: Odometry) -> None:
        self._stamps.append(odometry.stamp_ns)
        self._items.append(odometry)
        old = bisect.bisect_left(self._stamps, odometry.stamp_ns - _KEEP_NS)
        del self._stamps[:old], self._items[:old]

    def _beyond(self, stamp_ns: int) -> Pose2 | None:
        last = self._items[-1]
        ahead_ns = stamp_ns - last.stamp_ns
        if ahead_ns > _BEYOND_NS:
            return None
        return last.odom_from_robot @ travelled(last.velocity, ahead_ns * 1e-9)


def travelled(velocity: Velocity, seconds: float) -> Pose2:
    """Return ``before_from_after`` of a robot that drives at a constant velocity: an arc of a circle."""
    turn = velocity.w_radps * seconds
    chord = velocity.v_mps * seconds * float(np.sinc(turn / math.tau))
    return Pose2(chord * math.cos(turn / 2.0), chord * math.sin(turn / 2.0), turn)


def _jumped(before: Odometry, after: Odometry) -> bool:
    a, b = before.odom_from_robot, after.odom_from_robot
    elapsed_s = (after.stamp_ns - before.stamp_ns) * 1e-9
    moved = math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) > _JUMP_M + _JUMP_SPEED_MPS * elapsed_s
    turned = abs(wrap_angle(b.yaw_rad - a.yaw_rad)) > _JUMP_RAD + _JUMP_RATE_RADPS * elapsed_s
    return moved or turned


@dataclass(frozen=True, slots=True)
class TrackedPlan:
    """A plan with its place in the odometry frame.

    Attributes:
        plan: As it came.
        path_in_odom_m: (H + 1, 2), from where the robot was at the capture along the waypoints.
        received_ns: When it came, robot's clock.
    """

    plan: Plan
    path_in_odom_m: FloatArray
    received_ns: int

    def path_m(self, odom_from_robot: Pose2) -> FloatArray:
        """Return the path (H + 1, 2) in the frame of a robot that now stands there."""
        return odom_from_robot.inverse().apply(self.path_in_odom_m)


def track(plan: Plan, odom_from_capture: Pose2, received_ns: int) -> TrackedPlan:
    """Fix a plan in the odometry frame by the robot's pose at the plan's capture."""
    path = np.concatenate([np.zeros((1, 2)), plan.waypoints_m])
    return TrackedPlan(plan, odom_from_capture.apply(path), received_ns)
