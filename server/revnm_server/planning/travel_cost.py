"""What driving over each cell of the floor costs, when one knows only how probable obstacles are.

Around what surely stands there the costs are those of Nav2's inflation layer (``nav2_costmap_2d``,
``inflation_layer.hpp``), scaled as NavFn does (``navfn.hpp``: neutral cost 50, factor 0.8) and in units of a metre of
free floor. They are graded by probability: obstacles are cut out at several thresholds, and each cut brings its share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_client.mppi.distance_field import squared_distance
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.observation import Image32

_PER_NAV2 = 0.8 / 50.0
_AT_INSCRIBED = 252.0
_INSIDE = 300.0  # at the rim of the inscribed zone; twice as much in the obstacle


@dataclass(frozen=True, slots=True)
class CostSettings:
    """How dear it is to be near to obstacles and on floor that was not seen.

    Attributes:
        inscribed_m: Nearer to an obstacle the robot would touch it: very dear, but not forbidden.
        inflation_m: Farther away an obstacle costs nothing.
        decay_per_m: How fast the cost falls between the two.
        cuts: Probabilities, rising, all over 0.5 (which means "nothing known").
        shares: How much of an obstacle's cost each cut brings; they sum to 1.
        sure: From this probability on a cell is an obstacle that no way may cross.
        unseen: Price of a metre of floor that was not seen and of which nothing is believed, too; it falls to 1 with
            the belief that nothing stands there.
        aged: Price added to a metre of floor that was seen long ago.
        aging_s: Time after which 63 % of that is added.
    """

    inscribed_m: float = 0.22
    inflation_m: float = 0.70
    decay_per_m: float = 3.0
    cuts: tuple[float, ...] = (0.55, 0.65, 0.75, 0.85, 0.92)
    shares: tuple[float, ...] = (0.02, 0.05, 0.13, 0.30, 0.50)
    sure: float = 0.92
    unseen: float = 3.0
    aged: float = 0.3
    aging_s: float = 60.0


@dataclass(frozen=True, slots=True)
class TravelCost:
    """The cost of one grid.

    Attributes:
        grid: What it was made from.
        per_m: (Ny, Nx) float32, cost of a metre there, in metres of free floor that was just seen; finite everywhere.
        sure_m: (Ny, Nx) float32, distance to the nearest sure obstacle, 0 in it, metres, between middles of cells; inf
            where that is beyond the reach of what obstacles cost.
        outside: Cost of a metre outside of the grid.
    """

    grid: FloorGrid
    per_m: Image32
    sure_m: Image32
    outside: float

    def at(self, points_m: FloatArray) -> FloatArray:
        """Return the costs per metre (A, B) at points (A, B, 2), between cells by bilinear interpolation."""
        cells = self.grid.cells(points_m).astype(np.float32)
        return self.at_cells(cells[..., 0], cells[..., 1])

    def at_cells(self, rows: Image32, columns: Image32) -> FloatArray:
        """Return the same at cells (A, B), given by fractional rows and columns."""
        found = cv2.remap(
            self.per_m, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=self.outside
        )
        return np.asarray(found, dtype=np.float64)

    def of_way(self, way_m: FloatArray) -> float:
        """Return the cost of a way (P, 2), metres, whose points are at most half a cell apart."""
        if len(way_m) < 2:
            return 0.0
        middles = 0.5 * (way_m[1:] + way_m[:-1])
        return float(self.at(middles[None])[0] @ np.hypot(*np.diff(way_m, axis=0).T))


def travel_cost(grid: FloorGrid, settings: CostSettings) -> TravelCost:
    """Return what driving over each cell costs."""
    age = 1.0 - np.exp(-grid.age_s / settings.aging_s)
    doubt = np.minimum(2.0 * grid.obstacle, 1.0)  # 1 where nothing is known
    unseen = 1.0 + (settings.unseen - 1.0) * doubt
    per_m = np.where(grid.floor, 1.0 + settings.aged * age, unseen).astype(np.float32)
    reach = math.ceil(settings.inflation_m / grid.cell_m)
    away_m = _lengths_m(reach, grid.cell_m)
    nearness = _nearness(away_m, settings)
    for cut, share in zip(settings.cuts, settings.shares, strict=True):
        per_m += (np.float32(share) * nearness)[squared_distance(grid.obstacle >= cut, reach)]
    sure_m = away_m[squared_distance(grid.obstacle >= settings.sure, reach)]
    return TravelCost(grid, per_m, sure_m, settings.unseen)


def _lengths_m(reach: int, cell_m: float) -> NDArray[np.float32]:
    """Return the distances ((reach + 1)² + 1,) by their squares in cells; inf beyond the reach."""
    squares = np.arange((reach + 1) ** 2 + 1)
    lengths = np.sqrt(squares.astype(np.float32)) * np.float32(cell_m)
    return np.where(squares <= reach**2, lengths, np.float32(np.inf))


def _nearness(distance_m: NDArray[np.float32], settings: CostSettings) -> NDArray[np.float32]:
    """Return what an obstacle at a distance adds to the cost of a metre."""
    decay, inscribed = settings.decay_per_m, settings.inscribed_m
    rim = math.exp(-decay * (settings.inflation_m - inscribed))
    near = np.maximum(np.exp(-decay * (distance_m - inscribed)) - rim, 0.0)
    outside = _PER_NAV2 * _AT_INSCRIBED / (1.0 - rim) * near
    return np.where(distance_m > inscribed, outside, _INSIDE * (2.0 - distance_m / inscribed) - 1.0)
