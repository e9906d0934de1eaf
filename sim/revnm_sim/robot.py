"""The simulated robot: a Vstone Megarover with a 2D LiDAR and an AprilTag on its top plate.

Sources: vstoneofficial/megarover3_ros2 (Nav2 footprint 0.43 × 0.36 m), atinfinity/megarover_samples_ros2 (LiDAR
height and noise); the paper, section V-A, for the speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.frame import RobotSighting
from revnm_sim.camera import Camera


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """Sizes, metres, and limits of the robot. Its frame lies on the floor in the middle of the footprint."""

    length_m: float = 0.43
    width_m: float = 0.36
    top_m: float = 0.14
    lidar_height_m: float = 0.2155
    tag_m: float = 0.30
    max_v_mps: float = 0.5
    max_w_radps: float = 0.7

    @property
    def circumscribed_m(self) -> float:
        """Radius of the circle about the robot's middle that holds the footprint."""
        return math.hypot(self.length_m, self.width_m) / 2.0


def see_robot(camera: Camera, pose: Pose2, spec: RobotSpec, *, robot: str, stamp_ns: int) -> RobotSighting:
    """Return what a perfect tag detector reports for a robot in front of the camera, occlusion aside.

    Args:
        camera: The remote camera.
        pose: ``world_from_robot``.
        spec: The robot, with its tag centred on the top plate.
        robot: Name for the sighting.
        stamp_ns: Time of the sighting.
    """
    half = spec.tag_m / 2.0
    local = np.array([[0, 0], [1e-3, 0], [half, half], [half, -half], [-half, -half], [-half, half]], dtype=float)
    points = np.column_stack([pose.apply(local), np.full(len(local), spec.top_m)])
    pixels, _ = camera.project(points)
    step: FloatArray = pixels[1] - pixels[0]
    return RobotSighting(robot, stamp_ns, pixels[0], step / np.linalg.norm(step), pixels[2:])
