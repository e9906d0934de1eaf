"""The map as one robot sees it: a window around it, heading up, and where the goal is.

Planner and policy look through it. Imports numpy and OpenCV only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_grid import FloorGrid
from revnm_server.observation import Image32

LAYERS = ("obstacle", "floor", "unseen", "age", "lidar")
"""Of :attr:`MapWindow.layers`, in this order."""


@dataclass(frozen=True, slots=True)
class WindowSpec:
    """Size and ranges.

    Attributes:
        side: Cells of a side.
        cell_m: Side of a cell.
        longest_age_s: Age that the age layer calls 1; never seen is 1 too.
    """

    side: int = 96
    cell_m: float = 0.1
    longest_age_s: float = 30.0


@dataclass(frozen=True, slots=True)
class MapWindow:
    """What lies around a robot.

    Attributes:
        layers: (5, side, side) float32 in [0, 1]: :data:`LAYERS`. Row 0 is farthest ahead, column 0 farthest left;
            the robot stands in the middle. Off the map: obstacle 0.5, floor 0, unseen 1, age 1, lidar 0.5.
        goal_direction: (2,) unit vector to the goal in the robot's frame, x forward, y left; (1, 0) at the goal.
        goal_distance_m: How far the goal is, in the window or beyond.
    """

    layers: Image32
    goal_direction: FloatArray
    goal_distance_m: float


def map_window(
    grid: FloorGrid,
    floor_from_robot: Pose2,
    goal_m: FloatArray,
    lidar: Image32 | None = None,
    spec: WindowSpec | None = None,
) -> MapWindow:
    """Cut the window out of a map.

    Args:
        grid: The map.
        floor_from_robot: The robot's pose in the map's frame.
        goal_m: (2,) the goal in the map's frame.
        lidar: (Ny, Nx) float32, probability of an obstacle by the robot's scans alone; None: nothing known.
        spec: Size and ranges.
    """
    spec = spec or WindowSpec()
    matrix = _grid_from_window(grid, floor_from_robot, spec)
    known = grid.known
    age = np.clip(grid.age_s / np.float32(spec.longest_age_s), 0.0, 1.0)
    beams = np.full_like(grid.obstacle, 0.5) if lidar is None else lidar
    sources = ((grid.obstacle, 0.5), (grid.floor, 0.0), (~known, 1.0), (age, 1.0), (beams, 0.5))
    layers = [_warp(np.asarray(layer, dtype=np.float32), matrix, spec.side, rest) for layer, rest in sources]
    to_goal = floor_from_robot.inverse().apply(goal_m)
    distance = float(np.hypot(*to_goal))
    direction = to_goal / distance if distance > 1e-6 else np.array([1.0, 0.0])
    return MapWindow(np.stack(layers), direction, distance)


def window_points_m(spec: WindowSpec) -> FloatArray:
    """Return the middles (side, side, 2) of a window's cells in the robot's frame."""
    along = (0.5 * (spec.side - 1) - np.arange(spec.side)) * spec.cell_m
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)


def _grid_from_window(grid: FloorGrid, floor_from_robot: Pose2, spec: WindowSpec) -> FloatArray:
    """Return the affine map (2, 3) from (column, row) of the window to (column, row) of the grid."""
    middle, per = 0.5 * (spec.side - 1), spec.cell_m / grid.cell_m
    c, s = math.cos(floor_from_robot.yaw_rad), math.sin(floor_from_robot.yaw_rad)
    # In the robot's frame x = middle − row and y = middle − column, cells.
    linear = per * np.array([[s, -c], [-c, -s]])
    row, column = grid.cells(np.array(floor_from_robot[:2]))
    return np.column_stack([linear, np.array([column, row]) - linear @ np.array([middle, middle])])


def _warp(layer: Image32, matrix: FloatArray, side: int, rest: float) -> Image32:
    warped = cv2.warpAffine(
        layer,
        matrix,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=rest,
    )
    return np.asarray(warped, dtype=np.float32)
