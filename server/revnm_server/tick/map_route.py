"""What the map's navigator gives: a route for each robot, and what it knew then."""

from __future__ import annotations

from dataclasses import dataclass

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.mapping.floor_grid import FloorGrid


@dataclass(frozen=True, slots=True)
class MapRoute:
    """What a robot shall do.

    Attributes:
        waypoints_m: (H, 2) metres, frame of the robot at the picture's capture; None for no plan.
        way_m: (P, 2) the way in the camera's floor frame, metres; None without a map.
        reason: Why there is no plan, or what is provisional about it; empty where all is well.
        goal_m: (2,) the goal on the floor, the camera's floor frame; None where it is not known.
        arrived: The robot's middle is at the goal, and the camera has just seen it.
        aim_m: (2,) where the way should lead to: the goal, or where to look for it; None without a way.
    """

    waypoints_m: FloatArray | None
    way_m: FloatArray | None
    reason: str
    goal_m: FloatArray | None = None
    arrived: bool = False
    aim_m: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class NavigatorTick:
    """What one picture gave.

    Attributes:
        routes: By robot, for those that have a goal.
        places: floor_from_robot by robot, for those whose place is known.
        grid: The map, in the camera's floor frame; None while there is none.
        calibration: How well the camera is known.
        standing: A robot that the picture shows standing though its odometry has it drive; None where there is none.
    """

    routes: dict[str, MapRoute]
    places: dict[str, Pose2]
    grid: FloorGrid | None
    calibration: CalibrationState
    standing: str | None = None
