"""What a robot does that should drive and cannot: back off over floor that it knows, else turn to where there is room.

The controller never drives backwards; only this does, slowly and a little. At the same place each escape is waited for
twice as long as the one before it, and backs off farther: the robot gets out of a niche, and comes to rest in front of
something that stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.braking import BrakingConfig, comes_too_near, stopping_poses
from revnm_client.geometry import FloatArray, Pose2, wrap_angle
from revnm_client.messages import Velocity
from revnm_client.mppi.config import MppiConfig

BACKING_OFF = "stuck: backing off"
TURNING = "stuck: turning to where there is room"
NO_WAY_OUT = "stuck: no way out"
BACK_MPS = 0.15

_PATIENCE_NS = 5_000_000_000
_MOST_TRIES = 3  # that are counted: patience of 40 s
_CAN_TURN = 3  # times the patience with a robot that could turn: the controller may find a way round yet
LEAST_MPS, _TURNED_RAD = 0.02, 0.5  # who does less meanwhile does not get on: drifting and wobbling are less
_LEFT_M = 1.0  # so far from where the robot was stuck it has escaped
_BACK_M = 0.3  # of the first try
_PROBE_M = 0.1  # looked at behind the robot while it backs off, or more where it takes more to stop
_PROBE_STEP_M = 0.05
_STRIP_M = 0.08  # between two of the places that must have been seen
_TURN_RADPS = 0.5
_HEADINGS = 24
_ROOM_M, _ENOUGH_M, _MORE_M = 0.5, 1.0, 0.3  # least room, more than is needed, and more than ahead by this
_TURNED_TO_RAD = 0.1
_BACK_NS = 4_000_000_000  # of the first try: a wheel that slips, or a base that does not obey, ends it
_TURN_NS = 15_000_000_000


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the escape looks at in one tick.

    Attributes:
        odom_from_robot: Pose of the robot.
        points_m: (M, 2) obstacle points, robot frame now.
        seen: Tells which places (S, 2), robot frame now, the LiDAR has seen in the last seconds.
    """

    odom_from_robot: Pose2
    points_m: FloatArray
    seen: Callable[[FloatArray], NDArray[np.bool_]]


@dataclass(frozen=True, slots=True)
class WayOut:
    """What a stuck robot does.

    Attributes:
        velocity: To be sent, if the supervisor agrees; None: there is no way out, and the controller goes on trying.
        reason: In words for a person.
    """

    velocity: Velocity | None
    reason: str


@dataclass(frozen=True, slots=True)
class _Manoeuvre:
    """One escape under way.

    Attributes:
        velocity: Of the robot meanwhile.
        reason: In words.
        goal: Where it ends, in the odometry frame.
        end_ns: When it ends at the latest.
    """

    velocity: Velocity
    reason: str
    goal: Pose2
    end_ns: int


class Escape:
    """Watches whether the robot gets on while it should, and finds a way out where it does not.

    Call :meth:`step` in each tick in which the robot should drive, and :meth:`reset` in each other one.
    """

    def __init__(self, mppi: MppiConfig, braking: BrakingConfig) -> None:
        """Take the limits of the robot, and how it stops."""
        self._braking = braking
        self._back = Velocity(-min(BACK_MPS, mppi.max_v_mps), 0.0)
        stop_m = -float(stopping_poses(self._back, self._back, braking)[-1, 0])
        self._probe_m = max(_PROBE_M, stop_m)
        self._turn_radps = min(_TURN_RADPS, mppi.max_w_radps)
        self.forget()

    def forget(self) -> None:
        """Forget everything: the odometry's frame began anew."""
        self._tries = 0
        self._stuck_at: Pose2 | None = None
        self.reset()

    def reset(self) -> None:
        """Forget that the robot stood; where it was stuck before is kept."""
        self._since: tuple[Pose2, int] | None = None
        self._manoeuvre: _Manoeuvre | None = None

    def step(self, now_ns: int, around: Surroundings) -> WayOut | None:
        """Return the way out, or None where the robot gets on or is given time to.

        Args:
            now_ns: Robot's clock.
            around: Of the robot now.
        """
        pose = around.odom_from_robot
        if self._manoeuvre is not None:
            if self._goes_on(self._manoeuvre, now_ns, around):
                return WayOut(self._manoeuvre.velocity, self._manoeuvre.reason)
            self.reset()
        if self._stuck_at is not None and _distance_m(self._stuck_at, pose) > _LEFT_M:
            self._stuck_at, self._tries = None, 0
        if self._since is None or self._got_on(self._since[0], pose):
            self._since = pose, now_ns
        if self._is_patient(now_ns - self._since[1], around.points_m):
            return None
        self._manoeuvre = self._find(now_ns, around)
        if self._manoeuvre is None:
            return WayOut(None, NO_WAY_OUT)
        self._stuck_at = self._stuck_at or pose
        self._tries = min(self._tries + 1, _MOST_TRIES)
        return WayOut(self._manoeuvre.velocity, self._manoeuvre.reason)

    @property
    def _patience_ns(self) -> int:
        return _PATIENCE_NS << self._tries

    def _is_patient(self, stood_ns: int, points_m: FloatArray) -> bool:
        if stood_ns < self._patience_ns:
            return True
        can_turn = any(self._may_sweep(turn_rad, points_m) for turn_rad in (math.pi / 2.0, -math.pi / 2.0))
        return can_turn and stood_ns < _CAN_TURN * self._patience_ns

    def _got_on(self, before: Pose2, now: Pose2) -> bool:
        turned = abs(wrap_angle(now.yaw_rad - before.yaw_rad)) > _TURNED_RAD
        return turned or _distance_m(before, now) > LEAST_MPS * self._patience_ns * 1e-9

    def _find(self, now_ns: int, around: Surroundings) -> _Manoeuvre | None:
        pose = around.odom_from_robot
        if self._may_back(around):
            tries = min(self._tries + 1, _MOST_TRIES)
            goal = pose @ Pose2(-tries * _BACK_M, 0.0, 0.0)
            return _Manoeuvre(self._back, BACKING_OFF, goal, now_ns + tries * _BACK_NS)
        turn_rad = self._turn_to_room(around.points_m)
        if turn_rad is None:
            return None
        velocity = Velocity(0.0, math.copysign(self._turn_radps, turn_rad))
        return _Manoeuvre(velocity, TURNING, pose @ Pose2(0.0, 0.0, turn_rad), now_ns + _TURN_NS)

    def _goes_on(self, manoeuvre: _Manoeuvre, now_ns: int, around: Surroundings) -> bool:
        pose = around.odom_from_robot
        if now_ns >= manoeuvre.end_ns:
            return False
        if manoeuvre.reason == BACKING_OFF:
            left_m = (manoeuvre.goal.inverse() @ pose).x_m
            return left_m > 0.0 and self._may_back(around)
        return abs(wrap_angle(manoeuvre.goal.yaw_rad - pose.yaw_rad)) > _TURNED_TO_RAD

    def _may_back(self, around: Surroundings) -> bool:
        """Whether the next bit of floor behind the robot holds nothing, and has been seen to."""
        footprint, margin_m = self._braking.footprint, self._braking.margin_m
        steps = math.ceil(self._probe_m / _PROBE_STEP_M) + 1
        poses = np.zeros((steps, 3))
        poses[:, 0] = np.linspace(0.0, -self._probe_m, steps)
        if comes_too_near(poses, around.points_m, self._braking):
            return False
        half_m = footprint.width_m / 2.0 + margin_m
        x = footprint.rear_x_m - np.linspace(0.0, self._probe_m + margin_m, steps)
        y = np.linspace(-half_m, half_m, math.ceil(2.0 * half_m / _STRIP_M) + 1)
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return bool(around.seen(places).all())

    def _turn_to_room(self, points_m: FloatArray) -> float | None:
        """Return the angle to the nearest heading with room enough, or most room, that the body can turn to."""
        headings: FloatArray = math.tau / _HEADINGS * np.arange(_HEADINGS, dtype=np.float64)
        room = np.minimum(self._room_m(headings, points_m), _ENOUGH_M)
        fits = (room >= _ROOM_M) & (room > room[0] + _MORE_M)
        short = np.remainder(headings + math.pi, math.tau) - math.pi
        for index in np.lexsort((np.abs(short), -room)):
            for turn in (short[index], short[index] - math.copysign(math.tau, short[index])):
                if fits[index] and self._may_sweep(float(turn), points_m):
                    return float(turn)
        return None

    def _room_m(self, headings_rad: FloatArray, points_m: FloatArray) -> FloatArray:
        """Return how far (S,) the robot's front could drive straight on after turning to each heading."""
        cos, sin = np.cos(headings_rad)[:, None], np.sin(headings_rad)[:, None]
        ahead = cos * points_m[:, 0] + sin * points_m[:, 1]  # (S, M)
        beside = cos * points_m[:, 1] - sin * points_m[:, 0]
        footprint = self._braking.footprint
        in_lane = (ahead > 0.0) & (np.abs(beside) < footprint.width_m / 2.0 + self._braking.margin_m)
        free = np.where(in_lane, ahead, math.inf).min(axis=1, initial=math.inf)
        return np.asarray(free - footprint.front_x_m)

    def _may_sweep(self, turn_rad: float, points_m: FloatArray) -> bool:
        poses = np.zeros((math.ceil(abs(turn_rad) / 0.05) + 2, 3))
        poses[:, 2] = np.linspace(0.0, turn_rad, len(poses))
        return not comes_too_near(poses, points_m, self._braking)


def _distance_m(a: Pose2, b: Pose2) -> float:
    return math.hypot(b.x_m - a.x_m, b.y_m - a.y_m)
