"""What the remote camera's lifted picture says of the view that a robot would have: a guess that exo2ego completes.

Every pixel whose place is known is thrown into the robot's imagined picture, the nearest one wins; floor is known by
geometry wherever the map has seen it. What the camera cannot see stays open. Ideas: EgoWorld (arXiv:2506.17896), 4Diff
(ECCV 2024). Imports numpy only.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.lift import Kind, Lifted
from revnm_server.observation import Image32, ObservationSpec, normalise_ego_depth

PRIOR_CHANNELS = 2
_NEAREST_M = 0.15
_FREE = 0.5


def ego_prior(lifted: Lifted | None, grid: FloorGrid, floor_from_robot: Pose2, spec: ObservationSpec) -> Image32:
    """Return the guess of a robot's view.

    Args:
        lifted: The remote camera's picture; None where it could not be lifted.
        grid: The map, in the same frame.
        floor_from_robot: The robot's pose in it.
        spec: The robot's imagined camera.

    Returns:
        (2, ego_px, ego_px) float32: depth in [−1, 1], 1 where nothing is known; and 1 where something is, else 0.
    """
    depth = _floor_m(grid, floor_from_robot, spec)
    if lifted is not None:
        depth = np.minimum(depth, _standing_m(lifted, floor_from_robot, spec))
    known = np.isfinite(depth)
    return np.stack([normalise_ego_depth(depth, spec), known.astype(np.float32)])


def _focal_px(spec: ObservationSpec) -> float:
    return 0.5 * spec.ego_px / math.tan(0.5 * spec.ego_hfov_rad)


def _standing_m(lifted: Lifted, floor_from_robot: Pose2, spec: ObservationSpec) -> Image32:
    """Return the depth (ego_px, ego_px) of the nearest obstacle pixel thrown into each pixel; inf without one."""
    pixel = np.flatnonzero(lifted.kind == Kind.OBSTACLE)
    x, y = (layer.ravel()[pixel].astype(np.float64) for layer in (lifted.x_m, lifted.y_m))
    local = floor_from_robot.inverse().apply(np.stack([x, y], axis=1))
    ahead = local[:, 0]
    inside = (ahead > _NEAREST_M) & (ahead < spec.ego_range_m)
    ahead, aside, height = ahead[inside], local[inside, 1], lifted.height_m.ravel()[pixel][inside]
    middle, focal = 0.5 * (spec.ego_px - 1), _focal_px(spec)
    column = np.rint(middle - focal * aside / ahead).astype(np.int64)
    row = np.rint(middle - focal * (height - spec.ego_height_m) / ahead).astype(np.int64)
    seen = (column >= 0) & (column < spec.ego_px) & (row >= 0) & (row < spec.ego_px)
    depth = np.full(spec.ego_px**2, np.inf, dtype=np.float32)
    np.minimum.at(depth, row[seen] * spec.ego_px + column[seen], ahead[seen].astype(np.float32))
    return depth.reshape(spec.ego_px, spec.ego_px)


def _floor_m(grid: FloorGrid, floor_from_robot: Pose2, spec: ObservationSpec) -> Image32:
    """Return the depth (ego_px, ego_px) of floor that the map has seen; inf elsewhere."""
    ahead, points = _floor_points(spec)
    cells = np.rint(grid.cells(floor_from_robot.apply(points))).astype(np.int64)
    rows, columns = grid.obstacle.shape
    inside = (cells[..., 0] >= 0) & (cells[..., 0] < rows) & (cells[..., 1] >= 0) & (cells[..., 1] < columns)
    row, column = np.where(inside, cells[..., 0], 0), np.where(inside, cells[..., 1], 0)
    free: NDArray[np.bool_] = inside & grid.floor[row, column] & (grid.obstacle[row, column] < _FREE)
    return np.where(free, ahead, np.float32(np.inf)).astype(np.float32)


def _floor_points(spec: ObservationSpec) -> tuple[Image32, FloatArray]:
    """Return at which depth (e, e) the pixels' rays meet the floor, and where; what does not is put beyond range."""
    middle, focal = 0.5 * (spec.ego_px - 1), _focal_px(spec)
    down = (np.arange(spec.ego_px) - middle) / focal
    ahead = spec.ego_height_m / np.maximum(down, spec.ego_height_m / (4.0 * spec.ego_range_m))
    depth = np.broadcast_to(ahead[:, None], (spec.ego_px, spec.ego_px))
    aside = -depth * (np.arange(spec.ego_px) - middle) / focal
    return depth.astype(np.float32), np.stack([depth, aside], axis=-1)
