"""What a calibration is computed from: sightings of a robot's tag, each with the odometry of its moment.

A drive is a stretch of one robot's odometry without a jump. Its keyframes lie a little way or turn apart; of older ones
those go first that say the same as their neighbours. Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from revnm_client.geometry import FloatArray, Pose2, wrap_angle

_APART_M = 0.10
_APART_RAD = math.radians(12.0)
_RECENT = 4  # of the keyframes of the drive that was seen last none of the newest is dropped
DRIVES_OF_A_ROBOT = 1_000_000  # each robot's drives are numbered from a multiple of it


@dataclass(frozen=True, slots=True)
class TagMount:
    """How a tag lies on its robot, centred over the robot's frame.

    Attributes:
        size_m: Side of the black border.
        height_m: Over the floor.
    """

    size_m: float
    height_m: float

    def corners_m(self) -> FloatArray:
        """Return the corners (4, 2), robot frame: front left, front right, rear right, rear left."""
        half = self.size_m / 2.0
        return np.array([[half, half], [half, -half], [-half, -half], [-half, half]])


@dataclass(frozen=True, slots=True)
class Travel:
    """Odometry at a moment, with the way so far.

    Attributes:
        odom_from_robot: Pose in the odometry's frame.
        forward_m: Way driven since the drive began, backwards counted negative.
        way_m: The same, all counted positive.
        turn_rad: All turning since the drive began, both ways counted positive.
    """

    odom_from_robot: Pose2
    forward_m: float = 0.0
    way_m: float = 0.0
    turn_rad: float = 0.0

    def on(self, odom_from_robot: Pose2) -> Travel:
        """Return the travel at the next pose, a short way on."""
        step = self.odom_from_robot.inverse() @ odom_from_robot
        way = math.hypot(step.x_m, step.y_m)
        forward = math.copysign(way, step.x_m)
        turn = abs(step.yaw_rad)
        return Travel(odom_from_robot, self.forward_m + forward, self.way_m + way, self.turn_rad + turn)


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A sighting that the calibration keeps.

    Attributes:
        pixel: (2,) the tag's centre, pixels.
        heading: (2,) unit vector of the robot's forward axis in the picture.
        corners: (4, 2) pixels in the order of :meth:`TagMount.corners_m`; None where they are not known.
        travel: Odometry at the capture.
        mount: The tag.
        drive: Number of the drive.
    """

    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray | None
    travel: Travel
    mount: TagMount
    drive: int


@dataclass(slots=True)
class KeyframeSet:
    """The keyframes in use, oldest first, those of a drive in the order of time.

    Attributes:
        limit: Most keyframes that are kept; with many robots twice their number.
    """

    limit: int = 24
    frames: list[Keyframe] = field(default_factory=list)

    def wants(self, frame: Keyframe) -> bool:
        """Tell whether a sighting is far enough from the last keyframe of its drive to say something new."""
        last = self.last_of(frame.drive)
        if last is None:
            return True
        way, turn = frame.travel.way_m - last.travel.way_m, frame.travel.turn_rad - last.travel.turn_rad
        return way >= _APART_M or turn >= _APART_RAD

    def add(self, frame: Keyframe) -> None:
        """Take a keyframe; drop the one that is missed least if there are too many."""
        self.frames.append(frame)
        if len(self.frames) > max(self.limit, 2 * len(self._last_of_robots())):
            del self.frames[self._least_missed()]

    def last_of(self, drive: int) -> Keyframe | None:
        """Return the newest keyframe of a drive."""
        return next((frame for frame in reversed(self.frames) if frame.drive == drive), None)

    def travel_m(self) -> float:
        """Return the way from the first to the last keyframe of each drive, summed."""
        ways: dict[int, list[float]] = {}
        for frame in self.frames:
            ways.setdefault(frame.drive, []).append(frame.travel.way_m)
        return sum(way[-1] - way[0] for way in ways.values())

    def _last_of_robots(self) -> list[int]:
        """Return the indices of each robot's newest keyframe: none is dropped, it carries the robot's place."""
        return list({frame.drive // DRIVES_OF_A_ROBOT: i for i, frame in enumerate(self.frames)}.values())

    def _least_missed(self) -> int:
        """Return the index of the keyframe that lies nearest to another one in the picture and in heading."""
        newest = self.frames[-1].drive
        recent = [i for i, frame in enumerate(self.frames) if frame.drive == newest][-_RECENT:]
        spots = np.array([[*frame.pixel, *(40.0 * frame.heading)] for frame in self.frames])  # a turn of 1 rad: 40 px
        apart = np.linalg.norm(spots[:, None] - spots, axis=-1)
        np.fill_diagonal(apart, np.inf)
        loneliness = np.sort(apart, axis=1)[:, :2].sum(axis=1)
        loneliness[[*recent, *self._last_of_robots()]] = np.inf
        return int(loneliness.argmin())


def relative(frames: list[Keyframe]) -> tuple[FloatArray, FloatArray]:
    """Return what odometry says of the way between each keyframe and the one before.

    Returns:
        Motions (K − 1, 3) as (x, y, yaw) in the earlier robot's frame, and (K − 1, 3): forward way and whole way,
        metres, and all turning, radians. Across two drives they are meaningless.
    """
    motions, ways = [], []
    for before, after in pairwise(frames):
        step = before.travel.odom_from_robot.inverse() @ after.travel.odom_from_robot
        motions.append((step.x_m, step.y_m, wrap_angle(step.yaw_rad)))
        a, b = before.travel, after.travel
        ways.append((b.forward_m - a.forward_m, b.way_m - a.way_m, b.turn_rad - a.turn_rad))
    return np.array(motions).reshape(-1, 3), np.array(ways).reshape(-1, 3)
