"""What a map of the robot's surroundings should show, by the ray caster, and how well one does. Imports no PyBullet."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.map_window import WindowSpec, window_points_m
from revnm_sim.camera import Camera
from revnm_sim.occupancy import OccupancyGrid
from revnm_sim.rays.raycast import cast_depth, ray_grid, visible
from revnm_sim.scenario import at_height
from revnm_sim.world import FLAT_M, PrimitiveArrays

RADIUS_M = 4.0
_FINE = 3  # rays per pixel of the disparity, both ways, that look for obstacles
_PARTS = 4  # samples per cell, both ways, that ask for occupancy

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Truth:
    """The true cells of a window.

    Attributes:
        occupied: (side, side), an obstacle between 0.02 m and 0.40 m over the floor touches the cell.
        visible: (side, side), within 4 m of the robot the camera sees the cell: of a free cell its middle on the
            floor, of an occupied one any point of what stands in it. The robot itself hides nothing: where it stood
            before, the memory has seen.
        near: (side, side), within 4 m.
    """

    occupied: BoolArray
    visible: BoolArray
    near: BoolArray


def exact_calibration(camera: Camera) -> FloorCamera:
    """Return what a calibration of a camera should find; its floor frame is :func:`world_from_floor`."""
    size = (camera.width_px, camera.height_px)
    return FloorCamera(size, camera.focal_px, camera.pitch_rad, camera.roll_rad, camera.position_m[2])


def world_from_floor(camera: Camera) -> Pose2:
    """Return the floor frame of a camera: on the floor under it, x along its view."""
    x, y, _ = camera.position_m
    return Pose2(x, y, camera.yaw_rad)


def true_window(
    arrays: PrimitiveArrays, fine: OccupancyGrid, camera: Camera, pose: Pose2, hw: tuple[int, int], spec: WindowSpec
) -> Truth:
    """Return the truth around a robot.

    Args:
        arrays: The world's obstacles.
        fine: Its occupancy, in cells much smaller than the window's.
        camera: The remote camera.
        pose: ``world_from_robot``.
        hw: Height and width of the disparity; what only finer rays would meet counts as seen, too.
        spec: The window.
    """
    local = window_points_m(spec)
    world = pose.apply(local)
    near = np.hypot(local[..., 0], local[..., 1]) < RADIUS_M
    occupied = _occupied(fine, pose, local, spec.cell_m)
    floor = visible(arrays, camera, at_height(world.reshape(-1, 2), 0.0)).reshape(near.shape)
    struck = _struck(arrays, camera, pose, hw, spec)
    return Truth(occupied, np.where(occupied, struck, floor) & near, near)


def _occupied(fine: OccupancyGrid, pose: Pose2, local: FloatArray, cell_m: float) -> BoolArray:
    offsets = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) * cell_m
    shifts = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    points = pose.apply(local[..., None, :] + shifts)
    cells = np.floor((points - np.array(fine.origin_m)) / fine.resolution_m).astype(np.int64)
    rows, columns = fine.occupied.shape
    row, column = np.clip(cells[..., 1], 0, rows - 1), np.clip(cells[..., 0], 0, columns - 1)
    return np.asarray(fine.occupied[row, column].any(axis=-1))


def _struck(arrays: PrimitiveArrays, camera: Camera, pose: Pose2, hw: tuple[int, int], spec: WindowSpec) -> BoolArray:
    """Return the cells (side, side) in which a ray of the camera ends over the floor."""
    fine = (_FINE * hw[0], _FINE * hw[1])
    depth = cast_depth(arrays, camera, fine, max_depth_m=40.0).astype(np.float64)
    view = ray_grid(camera, fine)
    row, column = np.nonzero(np.isfinite(depth))
    rays = view[1] + column[:, None] * view[2] + row[:, None] * view[3]
    points = view[0] + depth[row, column][:, None] * rays
    standing = points[points[:, 2] > FLAT_M, :2]
    local = pose.inverse().apply(standing) / spec.cell_m
    cells = np.rint(0.5 * (spec.side - 1) - local).astype(np.int64)
    inside = ((cells >= 0) & (cells < spec.side)).all(axis=1)
    found = np.zeros((spec.side, spec.side), dtype=np.bool_)
    found[cells[inside, 0], cells[inside, 1]] = True
    return found


@dataclass(frozen=True, slots=True)
class Score:
    """Counts of cells within 4 m of the robot.

    Attributes:
        wanted: Visible occupied cells.
        found: Of them, how many have a cell of the map with p > 0.5 in it or beside it (8 neighbours).
        claimed: Cells of the map with p > 0.5, seen or not.
        right: Of them, how many have an occupied cell in them or beside them.
        floor: Visible free cells.
        open: Of them, how many the map knows to be floor with p < 0.5.
    """

    wanted: int
    found: int
    claimed: int
    right: int
    floor: int
    open: int


def score(truth: Truth, obstacle: NDArray[np.float32], floor: NDArray[np.float32]) -> Score:
    """Compare layers (side, side) of a window with the truth; the tolerance is one cell."""
    claimed = (obstacle > 0.5) & truth.near
    wanted = truth.occupied & truth.visible
    free = truth.visible & ~truth.occupied
    return Score(
        wanted=int(wanted.sum()),
        found=int((wanted & _grown(obstacle > 0.5)).sum()),
        claimed=int(claimed.sum()),
        right=int((claimed & _grown(truth.occupied)).sum()),
        floor=int(free.sum()),
        open=int((free & (floor > 0.5) & (obstacle < 0.5)).sum()),
    )


def _grown(cells: BoolArray) -> BoolArray:
    return np.asarray(cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0)
