"""Exact depth images and laser scans of a world, fast enough to train on; numba, one thread, without the GIL.

What is seen is the floor z = 0 and the primitives; a primitive that holds the camera is not. Grids (h, w) are
spread over the camera's picture, a ray through the middle of every cell, so any aspect is squeezed into them.
Must not import PyBullet: training runs this without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.observation import Image32, ObservationSpec
from revnm_sim.camera import Camera
from revnm_sim.rays.ray_kernels import BoolArray, hide, scan_ranges
from revnm_sim.rays.raycast_kernels import FLOOR, SKY, depth_of, normals_of, paint_all, paint_over
from revnm_sim.robot import RobotSpec
from revnm_sim.world import Primitive, PrimitiveArrays, Shape, primitive_arrays

__all__ = [
    "FLOOR",
    "SKY",
    "cast_depth",
    "cast_depths",
    "cast_ids",
    "cast_scan",
    "disparity_from_depth",
    "ego_camera",
    "overlay_depth",
    "ray_grid",
    "robot_primitive",
    "visible",
]

_ROBOT_COLOUR = (200, 200, 205)


def ray_grid(camera: Camera, grid_hw: tuple[int, int]) -> FloatArray:
    """Return the rays of a grid over a camera's picture, (7, 3), world frame.

    Row 0 is the optical centre, metres; row 1 the ray of cell (0, 0), rows 2 and 3 its change per column and
    per row, all rays of length 1 along the optical axis; rows 4 to 6 are the matrix that takes a vector from
    the optical centre to (column, row, 1) times its depth.
    """
    height, width = grid_hw
    rotation = camera.world_from_camera()
    per_column = camera.width_px / width / camera.focal_px
    per_row = camera.height_px / height / camera.focal_px
    view = np.empty((7, 3))
    view[0] = camera.position_m
    view[2] = rotation[:, 0] * per_column
    view[3] = rotation[:, 1] * per_row
    view[1] = rotation[:, 2] - view[2] * ((width - 1) / 2.0) - view[3] * ((height - 1) / 2.0)
    view[4] = rotation[:, 0] / per_column + rotation[:, 2] * ((width - 1) / 2.0)
    view[5] = rotation[:, 1] / per_row + rotation[:, 2] * ((height - 1) / 2.0)
    view[6] = rotation[:, 2]
    return view


def cast_depth(
    arrays: PrimitiveArrays, camera: Camera, grid_hw: tuple[int, int], *, max_depth_m: float = math.inf
) -> Image32:
    """Return the depth along the optical axis, (h, w) float32, metres; inf for sky and beyond the limit."""
    nearness, _ = paint_all(*arrays, ray_grid(camera, grid_hw), grid_hw)
    depth: Image32 = depth_of(nearness, max_depth_m)
    return depth


def cast_depths(
    arrays: PrimitiveArrays, cameras: Sequence[Camera], grid_hw: tuple[int, int], *, max_depth_m: float = math.inf
) -> Image32:
    """Return the depths of B cameras, (B, h, w), as of :func:`cast_depth`."""
    return np.stack([cast_depth(arrays, camera, grid_hw, max_depth_m=max_depth_m) for camera in cameras])


def cast_ids(
    arrays: PrimitiveArrays, camera: Camera, grid_hw: tuple[int, int]
) -> tuple[Image32, NDArray[np.int32], Image32]:
    """Return depth, what is seen, and its surface normal.

    Returns:
        Depth (h, w) float32, metres, as of :func:`cast_depth`; index of the primitive (h, w) int32, or
        FLOOR (−1) or SKY (−2); unit normal (h, w, 3) float32, world frame, 0 for sky.
    """
    view = ray_grid(camera, grid_hw)
    nearness, faces = paint_all(*arrays, view, grid_hw)
    ids, normals = normals_of(faces, nearness, arrays.centre_m, arrays.axis, view)
    return depth_of(nearness, math.inf), ids, normals


def overlay_depth(depth_m: Image32, camera: Camera, primitive: Primitive) -> Image32:
    """Return a depth image (h, w) of :func:`cast_depth` with one more primitive in it, as a copy.

    The result equals casting the world with the primitive, at the cost of the primitive's window alone.
    """
    depth = np.ascontiguousarray(depth_m).copy()
    height, width = depth.shape
    view = ray_grid(camera, (height, width))
    paint_over(*primitive_arrays((primitive,)), view, depth, np.zeros((height, width)))
    return depth


def cast_scan(
    arrays: PrimitiveArrays,
    world_from_robot: Pose2,
    *,
    height_m: float,
    angles_rad: FloatArray,
    max_range_m: float,
) -> Image32:
    """Return the ranges of a level laser scan from the robot's middle.

    Args:
        arrays: The world.
        world_from_robot: Pose of the robot.
        height_m: Height of the scan over the floor.
        angles_rad: (N,) beam angles in the robot frame, counter-clockwise from x.
        max_range_m: What is farther is not seen.

    Returns:
        (N,) float32, metres, inf where nothing is met.
    """
    angles = angles_rad + world_from_robot.yaw_rad
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    origin = np.array([world_from_robot.x_m, world_from_robot.y_m, height_m])
    return np.asarray(scan_ranges(*arrays, origin, directions, max_range_m), dtype=np.float32)


def visible(arrays: PrimitiveArrays, camera: Camera, points_m: FloatArray) -> BoolArray:
    """Return which world points (M, 3) lie in the picture with nothing before them, (M,) bool.

    A point on a surface is not hidden by that surface; a point under the floor is hidden.
    """
    pixels, depths = camera.project(points_m)
    seen = camera.inside(pixels, depths) & (points_m[:, 2] >= -1e-6)
    hide(*arrays, np.array(camera.position_m), np.ascontiguousarray(points_m), seen)
    return seen


def robot_primitive(pose: Pose2, spec: RobotSpec) -> Primitive:
    """Return the robot's body at ``world_from_robot`` as a box from the floor to its top plate."""
    return Primitive(
        shape=Shape.BOX,
        centre_m=(pose.x_m, pose.y_m, spec.top_m / 2.0),
        size_m=(spec.length_m, spec.width_m, spec.top_m),
        yaw_rad=pose.yaw_rad,
        colour=_ROBOT_COLOUR,
    )


def ego_camera(pose: Pose2, spec: ObservationSpec) -> Camera:
    """Return the robot's imagined camera: square, level, over the robot's middle, looking forward."""
    return Camera(
        width_px=spec.ego_px,
        height_px=spec.ego_px,
        hfov_rad=spec.ego_hfov_rad,
        position_m=(pose.x_m, pose.y_m, spec.ego_height_m),
        yaw_rad=pose.yaw_rad,
        pitch_rad=0.0,
    )


def disparity_from_depth(depth_m: Image32) -> Image32:
    """Return 1 / depth, 1/m; 0 for sky."""
    return np.asarray(np.float32(1.0) / depth_m, dtype=np.float32)
