"""A room with a camera and a robot on rails that the simulator's ray caster shows to a map pipeline."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import STANDSTILL, Odometry
from revnm_server.calibration.keyframes import TagMount
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import Image32
from revnm_server.ports import Heard
from revnm_server.tick.map_robot import RobotShape
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.world import Primitive, Shape, primitive_arrays

SIZE_PX, HW = (640, 480), (96, 128)
SPEC = RobotSpec()
SHAPE = RobotShape(TagMount(SPEC.tag_m, SPEC.top_m), SPEC.length_m, SPEC.width_m)
CAMERA = Camera(*SIZE_PX, math.radians(90.0), (0.0, 0.0, 2.6), 0.0, math.radians(32.0))
START, GOAL_M = Pose2(3.2, -1.2, 1.2), (3.4, 1.5)
_WALL = Primitive(Shape.BOX, (4.9, 0.0, 0.3), (0.3, 2.0, 0.6), 0.0, (90, 90, 90))


@dataclass(frozen=True)
class Click:
    id: str
    normalised: tuple[float, float]


def pixel_of(x_m: float, y_m: float) -> tuple[float, float]:
    """The pixel (u, v) to click for a place on the floor; edges of the picture at integers."""
    pixel, _ = CAMERA.project(np.array([x_m, y_m, 0.0]))
    return float(pixel[0] + 0.5), float(pixel[1] + 0.5)


class Room:
    """Depth, tags and a robot that goes where it is told, by the stamps of the pictures."""

    def __init__(self, robot: str = "rover") -> None:
        self.robot, self.pose = robot, START
        self.hidden = False
        self.frozen: Pose2 | None = None  # where the picture shows the robot, wherever it is
        self.begun = START  # where its odometry began
        self._poses: dict[int, Pose2] = {}
        self._background = cast_depth(primitive_arrays((_WALL,)), CAMERA, HW)
        self._rng = np.random.default_rng(0)

    def odometry(self, stamp_ns: int) -> Odometry:
        """What the robot measures now; the picture of that stamp will show it there."""
        self._poses[stamp_ns] = self.pose
        return Odometry(stamp_ns, self.begun.inverse() @ self.pose, STANDSTILL)

    def disparity(self, frame: Frame) -> Image32:
        depth = overlay_depth(self._background, CAMERA, robot_primitive(self._shown(frame), SPEC))
        return 3.0 * disparity_from_depth(depth) + np.float32(0.7)

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        if self.hidden:
            return []
        stamp_ns = frame.stamp_ns
        seen = see_robot(CAMERA, self._shown(frame), SPEC, robot=self.robot, stamp_ns=stamp_ns)
        noisy = replace(seen, corners=seen.corners + self._rng.normal(0.0, 0.3, (4, 2)))
        stranger = see_robot(CAMERA, Pose2(2.0, 0.0, 0.0), SPEC, robot="stranger", stamp_ns=stamp_ns)
        return [noisy, stranger]

    def _shown(self, frame: Frame) -> Pose2:
        return self.frozen or self._poses[frame.stamp_ns]

    def drive(self, waypoints_m: FloatArray, step_m: float = 0.08) -> None:
        """Go a step along the waypoints."""
        bearing = math.atan2(waypoints_m[0, 1], waypoints_m[0, 0])
        turn = float(np.clip(bearing, -0.14, 0.14))
        ahead = min(step_m if abs(bearing) < 0.6 else 0.0, float(np.hypot(*waypoints_m[-1])))
        self.pose @= Pose2(ahead * math.cos(turn / 2.0), ahead * math.sin(turn / 2.0), turn)

    def distance_m(self) -> float:
        """From the robot to the goal."""
        return math.hypot(self.pose.x_m - GOAL_M[0], self.pose.y_m - GOAL_M[1])


class Told:
    """Senses that hear what a test says."""

    def __init__(self) -> None:
        self.heard = Heard()
        self.rejected = {"rover/odom": 2}

    def listen(self) -> Heard:
        heard, self.heard = self.heard, Heard()
        return heard
