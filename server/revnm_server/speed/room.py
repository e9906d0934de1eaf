"""A room with robots that drive where they are told, as a camera on its wall and the robots themselves measure it.

Why: what a tick costs depends on what there is to do: tags to find, a map to draw, ways to search and to keep, scans to
hear. A server without a simulator must make all of that itself. Boxes stand between the robots and their goals; robots
do not touch, they pass through each other. The floor frame lies under the camera, as that of
:class:`revnm_server.floor_camera.FloorCamera`. Imports numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import STANDSTILL, Odometry, Scan
from revnm_server.floor_camera import FloorCamera
from revnm_server.observation import normalise_pixel
from revnm_server.ports import Heard

CAMERA = FloorCamera((1280, 960), focal_px=790.0, pitch_rad=math.radians(38.0), roll_rad=0.0, height_m=3.2)
ROBOT_LENGTH_M, ROBOT_WIDTH_M, TAG_HEIGHT_M, TAG_SIZE_M = 0.43, 0.36, 0.14, 0.30
_X_M, _Y_M = (1.6, 7.4), (-2.6, 2.6)  # where robots start and go
_SPEED_MPS, _TURN_RADPS = 0.5, 0.7
_ARRIVED_M = 0.5
_CLEAR_M, _APART_M = 0.45, 0.75
_CROWDED = 0.999  # so much nearer than the last one the next draw may lie
_HIDDEN_M = 0.5  # so far behind a box the camera may not see a tag
_BEAMS, _RANGE_M, _RANGE_NOISE_M = 720, 12.0, 0.015
_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class Box:
    """Something that stands on the floor, its sides along the axes of the floor frame.

    Attributes:
        centre_m: (x, y).
        size_m: (x, y).
        height_m: Of its top.
    """

    centre_m: tuple[float, float]
    size_m: tuple[float, float]
    height_m: float

    @property
    def outline_m(self) -> FloatArray:
        """Its corners (4, 2), counter-clockwise."""
        corners = 0.5 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return np.asarray(self.centre_m + corners * self.size_m)


BOXES = (
    Box((3.0, 0.9), (0.5, 0.9), 0.4),
    Box((3.2, -1.3), (0.9, 0.5), 0.3),
    Box((4.6, 0.1), (0.4, 1.6), 0.4),
    Box((5.0, -2.1), (0.6, 0.6), 0.5),
    Box((5.6, 1.9), (0.8, 0.6), 0.4),
    Box((6.3, -0.7), (0.6, 1.0), 0.5),
)
WALLS = (
    Box((8.1, 0.0), (0.2, 6.8), 2.5),
    Box((4.5, 3.3), (7.4, 0.2), 2.5),
    Box((4.5, -3.3), (7.4, 0.2), 2.5),
)


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal as an operator would click it; see :class:`revnm_server.ports.GoalPixel`."""

    id: str
    normalised: FloatArray


class RoomRobot:
    """One robot: follows its plans, and says what it measures; see :class:`revnm_server.ports.Senses`."""

    def __init__(self, name: str, place_m: tuple[float, float], rng: np.random.Generator) -> None:
        """Put it on a place, in any heading."""
        self.name = name
        self._rng = rng
        self._start = self.pose = Pose2(*place_m, rng.uniform(-math.pi, math.pi))
        self._goals = 0
        self._set_goal()
        self._odometry: list[Odometry] = []
        self._scans: list[Scan] = []
        self.rejected: dict[str, int] = {}

    def listen(self) -> Heard:
        """Return what it measured since the last time."""
        heard = Heard(tuple(self._odometry), tuple(self._scans))
        self._odometry, self._scans = [], []
        return heard

    def drive(self, waypoints_m: FloatArray | None, period_s: float) -> None:
        """Follow a plan (H, 2) for a tick; without one it stands. Where it arrives it gets another goal."""
        if waypoints_m is not None:
            bearing = math.atan2(waypoints_m[0, 1], waypoints_m[0, 0])
            turn = float(np.clip(bearing, -_TURN_RADPS * period_s, _TURN_RADPS * period_s))
            ahead = _SPEED_MPS * period_s if abs(bearing) < math.radians(40.0) else 0.0
            self.pose @= Pose2(ahead * math.cos(turn / 2.0), ahead * math.sin(turn / 2.0), turn)
        if math.dist(self.pose[:2], self._goal_m) < _ARRIVED_M:
            self._set_goal()

    def measure(self, stamp_ns: int, edges_m: FloatArray) -> None:
        """Read wheels and LiDAR.

        Args:
            stamp_ns: Now.
            edges_m: (E, 2, 2) what the LiDAR meets.
        """
        self._odometry.append(Odometry(stamp_ns, self._start.inverse() @ self.pose, STANDSTILL))
        ranges = cast(self.pose, edges_m, beams=_BEAMS) + self._rng.normal(0.0, _RANGE_NOISE_M, _BEAMS)
        scan = Scan(stamp_ns, -math.pi, math.tau / _BEAMS, 0.05, _RANGE_M, ranges.astype(np.float32))
        self._scans.append(scan)

    def _set_goal(self) -> None:
        """Draw a place at the other end of the room, so that ways are long."""
        far = self.pose.x_m < 0.5 * sum(_X_M)
        while True:
            self._goal_m = _free_place(self._rng)
            if (self._goal_m[0] > 0.5 * sum(_X_M)) == far:
                break
        pixel, _ = CAMERA.project(np.array([*self._goal_m, 0.0]))
        self._goals += 1
        self.goal = Goal(f"{self.name}-{self._goals}", normalise_pixel(pixel + 0.5, CAMERA.size_px))


class Room:
    """The room in time, a tick after the other."""

    def __init__(self, count: int, *, period_s: float) -> None:
        """Put robots into it, always the same for a count.

        Args:
            count: Of robots.
            period_s: Between two ticks.
        """
        rng = np.random.default_rng(7)
        self.robots = tuple(RoomRobot(f"r{number}", place, rng) for number, place in enumerate(_places(count, rng)))
        self._period_s = period_s
        self._edges_m = np.concatenate([_edges(box.outline_m) for box in (*BOXES, *WALLS)])
        self.stamp_ns = 1_000_000_000
        self._measure()

    @property
    def goals(self) -> dict[str, Goal]:
        """Where each robot should go now."""
        return {robot.name: robot.goal for robot in self.robots}

    def advance(self, waypoints_m: Mapping[str, FloatArray]) -> None:
        """Let a tick pass.

        Args:
            waypoints_m: Plans (H, 2) by robot, robot frame; who has none stands.
        """
        for robot in self.robots:
            robot.drive(waypoints_m.get(robot.name), self._period_s)
        self.stamp_ns += round(self._period_s * _NS_PER_S)
        self._measure()

    def _measure(self) -> None:
        for robot in self.robots:
            robot.measure(self.stamp_ns, self._edges_m)


def cast(pose: Pose2, edges_m: FloatArray, *, beams: int) -> FloatArray:
    """Return how far edges (E, 2, 2) are in each direction from a pose, (beams,), metres, the first straight back.

    Inf where there is nothing.
    """
    angles = pose.yaw_rad - math.pi + np.arange(beams) * (math.tau / beams)
    ahead = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]  # (beams, 1, 2)
    begin, along = edges_m[:, 0] - pose[:2], edges_m[:, 1] - edges_m[:, 0]  # (E, 2)
    across = ahead[..., 0] * along[:, 1] - ahead[..., 1] * along[:, 0]  # (beams, E)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / across
        share = (begin[:, 0] * ahead[..., 1] - begin[:, 1] * ahead[..., 0]) / across
    met = (reach > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.asarray(np.where(met, reach, np.inf).min(axis=1))


def _edges(outline_m: FloatArray) -> FloatArray:
    return np.stack([outline_m, np.roll(outline_m, -1, axis=0)], axis=1)


def _places(count: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Draw places for robots, apart from each other as far as there is room for that."""
    places: list[tuple[float, float]] = []
    apart_m = _APART_M
    while len(places) < count:
        place = _free_place(rng)
        if all(math.dist(place, other) >= apart_m for other in places):
            places.append(place)
        apart_m *= _CROWDED
    return places


def _free_place(rng: np.random.Generator) -> tuple[float, float]:
    """Draw a place where a robot stands clear of the boxes, and the camera sees it over them."""
    while True:
        place = rng.uniform(_X_M[0], _X_M[1]), rng.uniform(_Y_M[0], _Y_M[1])
        behind = np.array([0.5 * _HIDDEN_M, 0.0])
        gaps = (np.abs(place - behind - box.centre_m) - behind - 0.5 * np.array(box.size_m) for box in BOXES)
        if all(gap.max() > _CLEAR_M for gap in gaps):
            return place
