"""What one picture gave on the map, for those who show it."""

from __future__ import annotations

from dataclasses import dataclass, field

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.mapping.floor_grid import FloorGrid


@dataclass(frozen=True, slots=True)
class SiteRoute:
    """Where a robot with a goal is led.

    Attributes:
        reason: Why it is not, or what is provisional about it; empty where all is well.
        way_m: (P, 2) its way, metres, the camera's floor frame; None without a way on the map.
        way_px: (Q, 2) what of it lies in front of the camera, pixels; None with the way.
        goal_m: (2,) the goal on the floor; None where it is not known.
        arrived: The robot's middle is at the goal.
    """

    reason: str
    way_m: FloatArray | None = None
    way_px: FloatArray | None = None
    goal_m: FloatArray | None = None
    arrived: bool = False


@dataclass(frozen=True, slots=True)
class SiteReport:
    """The camera and its map as of one picture.

    Attributes:
        stamp_ns: Its capture time, nanoseconds, server's clock.
        calibration: How well the camera is known.
        grid: The map, in the camera's floor frame; None while there is none.
        places: floor_from_robot of the robots whose place is known.
        routes: By robot, for those that have a goal.
        warnings: What an operator should know.
        rejected: Number of the robots' payloads that were refused, by key.
        scans: The newest scan of each robot that sends any, stamped in the server's clock.
        standing: A robot that the picture shows standing though its odometry has it drive; None where there is none.
    """

    stamp_ns: int
    calibration: CalibrationState
    grid: FloorGrid | None
    places: dict[str, Pose2]
    routes: dict[str, SiteRoute]
    warnings: tuple[str, ...]
    rejected: dict[str, int]
    scans: dict[str, Scan] = field(default_factory=dict)
    standing: str | None = None
