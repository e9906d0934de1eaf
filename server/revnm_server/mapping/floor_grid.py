"""What is known of the floor, cell by cell: the meeting point of the lift, the LiDAR and the planner.

Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32

_MARGIN = 10  # cells, wider than what an obstacle makes dear around it
_STEP = 20  # cells


@dataclass(frozen=True, slots=True)
class FloorGrid:
    """Layers over a rectangle of the floor, rows along y, columns along x.

    Attributes:
        origin_m: (x, y) of the middle of cell (0, 0), metres, in the frame of the map.
        cell_m: Side of a cell.
        obstacle: (Ny, Nx) float32 in [0, 1], probability that something stands there that the robot would touch;
            0.5 where nothing is known.
        floor: (Ny, Nx) bool, the floor was seen there, or a laser beam went through.
        age_s: (Ny, Nx) float32, time since the cell was last seen; inf where it never was.
    """

    origin_m: tuple[float, float]
    cell_m: float
    obstacle: Image32
    floor: NDArray[np.bool_]
    age_s: Image32

    @property
    def known(self) -> NDArray[np.bool_]:
        """(Ny, Nx) whether the cell was ever seen."""
        return np.asarray(np.isfinite(self.age_s))

    def told(self, points_m: FloatArray) -> FloorGrid:
        """Return the part that holds every cell of which anything is known or believed, and points (M, 2).

        Points off the grid count as the cells nearest to them. Around all that lies a margin, where the grid goes on,
        so that a way through the unknown beyond is no cheaper than one along the margin. The part's bounds change in
        steps, so that parts have few shapes.
        """
        known = self.known | (self.obstacle != np.float32(0.5))
        held = [np.flatnonzero(known.any(axis=1 - axis)) for axis in range(2)]
        cells = self._nearest(points_m)
        if len(held[0]):
            cells = np.concatenate([cells, [[each[end] for each in held] for end in (0, -1)]])
        return self._part(cells, _MARGIN)

    def around(self, points_m: FloatArray, margin_m: float) -> FloorGrid:
        """Return the part that holds points (M, 2) and a margin about them, with bounds as of :meth:`told`."""
        return self._part(self._nearest(points_m), margin_m / self.cell_m)

    def _nearest(self, points_m: FloatArray) -> FloatArray:
        """Return the cells (M, 2) of points (M, 2); of those off the grid the nearest."""
        return np.clip(self.cells(points_m), 0.0, np.array(self.obstacle.shape) - 1.0)

    def _part(self, cells: FloatArray, margin: float) -> FloorGrid:
        """Return the part that holds cells (M, 2) and a margin, in cells, widened to the next steps."""
        window = []
        for axis, size in enumerate(self.obstacle.shape):
            first, last = cells[:, axis].min() - margin, cells[:, axis].max() + margin + 1.0
            window.append(slice(max(0, math.floor(first / _STEP) * _STEP), min(size, math.ceil(last / _STEP) * _STEP)))
        part = (window[0], window[1])
        corner = self.points_m(np.array([each.start for each in part], dtype=np.float64))
        origin_m = float(corner[0]), float(corner[1])
        return FloorGrid(origin_m, self.cell_m, self.obstacle[part], self.floor[part], self.age_s[part])

    def cells(self, points_m: FloatArray) -> FloatArray:
        """Return the cells (..., 2) as (row, column), middles at integers, of points (..., 2)."""
        return np.asarray((points_m - np.array(self.origin_m))[..., ::-1] / self.cell_m)

    def covers(self, point_m: FloatArray) -> bool:
        """Tell whether a point (2,) lies in one of the cells."""
        cell = self.cells(point_m)
        return bool(np.all((cell >= -0.5) & (cell <= np.array(self.obstacle.shape) - 0.5)))

    def points_m(self, cells: FloatArray) -> FloatArray:
        """Return the points (..., 2), metres, of cells (..., 2) as (row, column)."""
        return np.asarray(np.array(self.origin_m) + cells[..., ::-1] * self.cell_m)
