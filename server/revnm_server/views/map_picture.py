"""Draws the map of the floor for people: what is free, what stands where, the robots, their ways and goals."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.tick.site_report import SiteReport

_CELL_PX = 4
_UNSEEN = (38, 44, 50)
_FREE = np.array([196.0, 204.0, 210.0])
_OBSTACLE = np.array([214.0, 69.0, 61.0])
_WAY, _GOAL, _ROBOT, _CAMERA = (38, 120, 214), (255, 176, 0), (24, 150, 80), (233, 237, 240)
_ROBOT_M = 0.25
_MARGIN_M = 1.0  # around what is known
_GRID_M = 1.0  # marks on the floor, for the scale
_MARK = (120, 128, 135)
_EDGE = (14, 17, 20)

Picture = NDArray[np.uint8]


def map_picture(report: SiteReport) -> Picture:
    """Return the map as a picture (h, w, 3) uint8, RGB: the camera looks up; as large as what is known, and 1 m more.

    Args:
        report: What is known; without a map all is shown as unseen.
    """
    canvas = _Canvas(report.grid, _marked_m(report))
    for robot, route in report.routes.items():
        if route.way_m is not None and not route.arrived:
            canvas.line(route.way_m, _WAY)
        if route.goal_m is not None:
            canvas.ring(route.goal_m, _GOAL)
        if robot in report.places:
            canvas.arrow(report.places[robot], _ROBOT)
    for robot, place in report.places.items():
        if robot not in report.routes:
            canvas.arrow(place, _ROBOT)
    return canvas.picture


def _marked_m(report: SiteReport) -> FloatArray:
    """Return the places (N, 2) of the camera, the robots and their goals."""
    robots = [place[:2] for place in report.places.values()]
    goals = [route.goal_m for route in report.routes.values() if route.goal_m is not None]
    return np.array([(0.0, 0.0), *robots, *goals])


class _Canvas:
    """A picture of the floor with x up and y to the left."""

    def __init__(self, grid: FloorGrid | None, marked_m: FloatArray) -> None:
        spec = MapSpec()
        origin_m, self._cell_m = (grid.origin_m, grid.cell_m) if grid is not None else (spec.origin_m, spec.cell_m)
        cells = np.empty((*(grid.obstacle.shape if grid is not None else spec.shape), 3), np.uint8)
        cells[:] = _UNSEEN
        shown = np.zeros(cells.shape[:2], dtype=np.bool_)
        if grid is not None:
            share = np.square(np.clip(grid.obstacle, 0.0, 1.0))[..., None]  # floor that is a little in doubt is bright
            shown = grid.known & (grid.floor | (grid.obstacle != 0.5))
            cells[shown] = ((1.0 - share) * _FREE + share * _OBSTACLE)[shown].astype(np.uint8)
        marked = np.rint((marked_m - np.array(origin_m)) / self._cell_m)[:, ::-1]
        first, last = _bounds(
            np.concatenate([np.argwhere(shown), marked]), shown.shape, round(_MARGIN_M / self._cell_m)
        )
        cells = cells[first[0] : last[0], first[1] : last[1]]
        rows, columns = cells.shape[:2]
        self._origin_m = origin_m[0] + self._cell_m * first[1], origin_m[1] + self._cell_m * first[0]
        self._shape = columns, rows  # of the picture, in cells: x becomes rows
        upright = cells.transpose(1, 0, 2)[::-1, ::-1]  # (columns, rows, 3)
        size_px = (rows * _CELL_PX, columns * _CELL_PX)
        self.picture: Picture = np.asarray(
            cv2.resize(np.ascontiguousarray(upright), size_px, interpolation=cv2.INTER_NEAREST), dtype=np.uint8
        )
        self._mark_metres()
        self.arrow(Pose2(0.0, 0.0, 0.0), _CAMERA)

    def line(self, points_m: FloatArray, colour: tuple[int, int, int]) -> None:
        """Draw a line through points (N, 2)."""
        pixels = self._pixels(points_m).round().astype(np.int32)
        cv2.polylines(self.picture, [pixels], False, colour, 3, cv2.LINE_AA)

    def ring(self, point_m: FloatArray, colour: tuple[int, int, int]) -> None:
        """Draw a ring around a point (2,)."""
        u, v = self._pixels(point_m)
        for width, ink in ((6, _EDGE), (3, colour)):
            cv2.circle(self.picture, (round(u), round(v)), 11, ink, width, cv2.LINE_AA)

    def arrow(self, pose: Pose2, colour: tuple[int, int, int]) -> None:
        """Draw an arrow head at a pose."""
        angles = np.array([0.0, 2.5, math.pi, -2.5])
        reach = _ROBOT_M * np.array([1.3, 1.0, 0.35, 1.0])
        outline = pose.apply(np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1))
        pixels = self._pixels(outline).round().astype(np.int32)
        cv2.fillPoly(self.picture, [pixels], colour, cv2.LINE_AA)
        cv2.polylines(self.picture, [pixels], True, _EDGE, 1, cv2.LINE_AA)

    def _mark_metres(self) -> None:
        height_px, width_px = self.picture.shape[:2]
        columns, rows = self._shape
        far_m = np.array(self._origin_m) + self._cell_m * np.array([columns - 1, rows - 1])
        xs, ys = (
            np.arange(math.ceil(low / _GRID_M), math.floor(high / _GRID_M) + 1) * _GRID_M
            for low, high in zip(self._origin_m, far_m, strict=True)
        )
        places = self._pixels(np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)).round().astype(int)
        inside = np.all((places >= 0) & (places < (width_px, height_px)), axis=1)
        u, v = places[inside].T
        self.picture[v, u] = _MARK

    def _pixels(self, points_m: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) as (u, v) of points (..., 2)."""
        columns, rows = self._shape
        cells = (points_m - np.array(self._origin_m)) / self._cell_m  # (column, row) of the grid
        u = (rows - 0.5 - cells[..., 1]) * _CELL_PX
        v = (columns - 0.5 - cells[..., 0]) * _CELL_PX
        return np.asarray(np.clip(np.stack([u, v], axis=-1), -1e4, 1e4))


def _bounds(cells: FloatArray, shape: tuple[int, int], margin: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first (row, column) and the one after the last of what encloses cells (N, 2) with a margin."""
    low, high = cells.min(axis=0) - margin, cells.max(axis=0) + margin + 1
    return np.clip(low, 0, np.array(shape) - 1).astype(np.intp), np.clip(high, 1, shape).astype(np.intp)
