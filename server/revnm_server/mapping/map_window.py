"""The map as one robot sees it: a window around it, heading up.

The policy looks through it. Imports numpy and OpenCV only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.observation import Image32

LAYERS = ("obstacle", "floor", "unseen", "lidar")
"""Of a window, in this order."""

WAY_POINTS = 12
"""P, points of the planner's way that the policy sees, as far apart as waypoints."""


_NOWHERE = -1e6  # mixed with a layer in [0, 1] in any share it stays negative


@dataclass(frozen=True, slots=True)
class WindowSpec:
    """Size.

    Attributes:
        side: Cells of a side.
        cell_m: Side of a cell.
    """

    side: int = 96
    cell_m: float = 0.1


def map_window(
    grid: FloorGrid, floor_from_robot: Pose2, lidar: Image32 | None = None, spec: WindowSpec | None = None
) -> Image32:
    """Cut the window out of a map.

    Args:
        grid: The map.
        floor_from_robot: The robot's pose in the map's frame.
        lidar: (Ny, Nx) float32, probability of an obstacle by the robot's scans alone; None: nothing known.
        spec: Size.

    Returns:
        (4, side, side) float32 in [0, 1]: :data:`LAYERS`. Row 0 is farthest ahead, column 0 farthest left; the robot
        stands in the middle. Off the map: obstacle 0.5, floor 0, unseen 1, lidar 0.5.
    """
    spec = spec or WindowSpec()
    matrix = _grid_from_window(grid, floor_from_robot, spec)
    beams = np.full_like(grid.obstacle, 0.5) if lidar is None else lidar
    sources = ((grid.obstacle, 0.5), (grid.floor, 0.0), (~grid.known, 1.0), (beams, 0.5))
    return np.stack([_warp(np.asarray(layer, dtype=np.float32), matrix, spec.side, rest) for layer, rest in sources])


def onto_grid(window: Image32, grid: FloorGrid, floor_from_robot: Pose2, spec: WindowSpec | None = None) -> Image32:
    """Draw a layer (side, side) of a robot's window onto the map's cells, (Ny, Nx); NaN beyond the window."""
    spec = spec or WindowSpec()
    matrix = cv2.invertAffineTransform(_grid_from_window(grid, floor_from_robot, spec))
    size, flags = grid.obstacle.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    drawn = cv2.warpAffine(window, matrix, size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=_NOWHERE)
    return np.where(drawn < 0.0, np.float32(np.nan), drawn).astype(np.float32)


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
