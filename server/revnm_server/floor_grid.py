"""What is known of the floor, cell by cell: the meeting point of the lift, the LiDAR and the planner.

Imports numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32


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
