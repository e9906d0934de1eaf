"""Builds worlds and robots in a PyBullet client, for the physics and for the renderer alike."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

from revnm_client.geometry import Pose2
from revnm_sim.robot import RobotSpec
from revnm_sim.robot_model import robot_urdf
from revnm_sim.world import Primitive, Shape, World

_FLOOR_MARGIN_M = 20.0
_CYLINDER_SIDES = 48


def add_floor(client: int, world: World) -> int:
    """Add the floor at z = 0, with its top as an endless plane for contacts, and return its body number."""
    bounds = world.bounds
    half = (
        (bounds.x_max_m - bounds.x_min_m) / 2.0 + _FLOOR_MARGIN_M,
        (bounds.y_max_m - bounds.y_min_m) / 2.0 + _FLOOR_MARGIN_M,
        0.05,
    )
    middle = ((bounds.x_min_m + bounds.x_max_m) / 2.0, (bounds.y_min_m + bounds.y_max_m) / 2.0, -0.05)
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=(0.0, 0.0, 1.0), physicsClientId=client)
    slab = pybullet.createVisualShape(
        pybullet.GEOM_BOX,
        halfExtents=half,
        rgbaColor=_rgba(world.floor_colour),
        visualFramePosition=middle,
        physicsClientId=client,
    )
    return int(pybullet.createMultiBody(0.0, plane, slab, physicsClientId=client))


def add_obstacle(client: int, primitive: Primitive) -> int:
    """Add a primitive that never moves and return its body number."""
    x, y, z = primitive.size_m
    size: dict[str, Any]
    if primitive.shape is Shape.BOX:
        kind, size = pybullet.GEOM_BOX, {"halfExtents": (x / 2.0, y / 2.0, z / 2.0)}
        solid = pybullet.createCollisionShape(kind, **size, physicsClientId=client)
    else:
        kind, size = pybullet.GEOM_MESH, _cylinder_mesh(x / 2.0, z)
        solid = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, radius=x / 2.0, height=z, physicsClientId=client)
    visual = pybullet.createVisualShape(kind, **size, rgbaColor=_rgba(primitive.colour), physicsClientId=client)
    return int(
        pybullet.createMultiBody(
            0.0,
            solid,
            visual,
            primitive.centre_m,
            yaw_quaternion(primitive.yaw_rad),
            physicsClientId=client,
        )
    )


def add_robot(client: int, pose: Pose2, spec: RobotSpec) -> tuple[int, dict[str, int]]:
    """Add the robot on the floor at a pose (``world_from_robot``).

    Returns:
        Its body number, and the number of every joint, which is that of the link behind it, by name.
    """
    with tempfile.TemporaryDirectory(prefix="revnm-") as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(robot_urdf(spec), encoding="utf-8")
        body = pybullet.loadURDF(
            str(path),
            (pose.x_m, pose.y_m, 0.0),
            yaw_quaternion(pose.yaw_rad),
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
    joints: dict[str, int] = {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        joints[pybullet.getJointInfo(body, index, physicsClientId=client)[1].decode()] = index
    return int(body), joints


def yaw_quaternion(yaw_rad: float) -> tuple[float, float, float, float]:
    """Return the turn about z as (x, y, z, w)."""
    return 0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)


def _cylinder_mesh(radius_m: float, height_m: float) -> dict[str, list[Any]]:
    """Return vertices, normals and triangles of a round cylinder; PyBullet's own has visible corners."""
    angles = np.linspace(0.0, math.tau, _CYLINDER_SIDES, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    bottom, top = ring * radius_m - up * height_m / 2.0, ring * radius_m + up * height_m / 2.0
    vertices = np.vstack([bottom, top, top, [up * height_m / 2.0]])  # side below, side above, cap, its middle
    normals = np.vstack([ring, ring, np.tile(up, (_CYLINDER_SIDES + 1, 1))])
    here = np.arange(_CYLINDER_SIDES)
    then, above, cap = np.roll(here, -1), _CYLINDER_SIDES, 2 * _CYLINDER_SIDES
    middle = np.full(_CYLINDER_SIDES, 3 * _CYLINDER_SIDES)
    triangles = np.concatenate(
        [
            np.stack([here, then, then + above], axis=1),
            np.stack([here, then + above, here + above], axis=1),
            np.stack([here + cap, then + cap, middle], axis=1),
        ]
    )
    return {"vertices": vertices.tolist(), "normals": normals.tolist(), "indices": triangles.ravel().tolist()}


def _rgba(colour: tuple[int, int, int]) -> tuple[float, float, float, float]:
    return colour[0] / 255.0, colour[1] / 255.0, colour[2] / 255.0, 1.0
