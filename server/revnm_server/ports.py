"""What the pipeline asks of its stages: each stage can be a network, the simulator's truth, or a fake.

Stages import this module and never each other. Symbols: R robots, N frames of history, H waypoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from revnm_client.geometry import IDENTITY, FloatArray, Pose2
from revnm_client.messages import Odometry, Scan
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import Image32, ImagePose


class GoalPixel(Protocol):
    """A goal in the picture, as far as the pipeline cares."""

    @property
    def id(self) -> str:
        """The goal's name; the plan carries it."""
        ...

    @property
    def normalised(self) -> FloatArray | tuple[float, float]:
        """(2,) the goal's pixel divided by the picture's width and height."""
        ...


@dataclass(frozen=True, slots=True)
class EgoRequest:
    """One robot's input to exo2ego.

    Attributes:
        robot: The robot's name.
        stamp_ns: Capture time of the newest picture, nanoseconds, server's clock.
        pose: Where the robot is in the picture.
        crops: (N, crop_px, crop_px) in [0, 1], oldest first, all cut around ``pose``.
        prior: (2, ego_px, ego_px) of :func:`revnm_server.mapping.ego_prior.ego_prior`; None where there is no map.
    """

    robot: str
    stamp_ns: int
    pose: ImagePose
    crops: Image32
    prior: Image32 | None = None


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """One robot's input to a planner.

    Attributes:
        robot: The robot's name.
        stamp_ns: Capture time of the newest picture, nanoseconds, server's clock.
        sighting: Where the robot was seen last.
        pose: The same for the networks.
        goal: (2,) normalised pixel.
        goal_id: The goal's name.
        exo: (N, h, w) in [0, 1], oldest first, the picture's disparity.
        ego: (N, ego_px, ego_px) in [−1, 1], oldest first, what the robot would see.
    """

    robot: str
    stamp_ns: int
    sighting: RobotSighting
    pose: ImagePose
    goal: FloatArray
    goal_id: str
    exo: Image32
    ego: Image32


@dataclass(frozen=True, slots=True)
class BeliefRequest:
    """One robot's input to a policy that sees the map.

    Attributes:
        window: (4, side, side) of :func:`revnm_server.mapping.map_window.map_window`.
        way: (P, 2) points of the planner's way, robot frame, metres.
        goal: (2,) robot frame, metres.
        ego: (ego_px, ego_px) in [−1, 1], what the robot would see.
    """

    window: Image32
    way: FloatArray
    goal: FloatArray
    ego: Image32


@dataclass(frozen=True, slots=True)
class Heard:
    """What a robot sent since it was listened to last, oldest first, stamps in the server's clock.

    ``clock_offset_ns`` was added to the robot's own stamps. ``robot_from_lidar`` is where the scans were taken, as the
    robot's state tells it; the scans have it, too.
    """

    odometry: tuple[Odometry, ...] = ()
    scans: tuple[Scan, ...] = ()
    clock_offset_ns: int = 0
    robot_from_lidar: Pose2 = IDENTITY


class Senses(Protocol):
    """Hears what a robot measures itself."""

    @property
    def rejected(self) -> dict[str, int]:
        """Number of payloads that were refused, by key."""
        ...

    def listen(self) -> Heard:
        """Return what came since the last time; never blocks."""
        ...


class DisparitySource(Protocol):
    """Sees how near things are. Another thread may ask it than asks for sightings, at the same time."""

    def disparity(self, frame: Frame) -> Image32:
        """Return the disparity (h, w) of ``ObservationSpec.disparity_hw``, up to scale and shift; finite."""
        ...


class SightingSource(Protocol):
    """Sees where the robots are."""

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        """Return the robots that are visible in this picture, at most one sighting per robot.

        ``expected`` tells about where the corners (4, 2) of their tags should be, seen or hidden, by robot.
        """
        ...


class EgoDepth(Protocol):
    """Tells what robots would see ahead of them."""

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        """Return ego depth (R, ego_px, ego_px) in [−1, 1], one per request; R may be 0."""
        ...


class Planner(Protocol):
    """Decides where robots go."""

    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        """Return (R, H, 2), metres, in each robot's frame at its sighting's stamp; R may be 0."""
        ...


class FloorPolicy(Protocol):
    """Judges the floor around robots, seen or hidden."""

    def believe(self, requests: Sequence[BeliefRequest]) -> Image32:
        """Return the probabilities (R, side, side) that something stands in a window's cells; R is at least 1."""
        ...
