"""Grids of floor for tests, empty or with rectangles in them."""

from __future__ import annotations

import numpy as np

from revnm_server.mapping.floor_grid import FloorGrid

CELL_M = 0.1


def floor(width_m: float, height_m: float, *boxes: tuple[float, float, float, float], p: float = 0.99) -> FloorGrid:
    """A seen floor, its corner (0, 0), with obstacles on rectangles (x0, y0, x1, y1)."""
    shape = round(height_m / CELL_M), round(width_m / CELL_M)
    obstacle = np.full(shape, 0.02, dtype=np.float32)
    for x0, y0, x1, y1 in boxes:
        obstacle[round(y0 / CELL_M) : round(y1 / CELL_M), round(x0 / CELL_M) : round(x1 / CELL_M)] = p
    return with_obstacles(obstacle)


def with_obstacles(obstacle: np.ndarray, *, cell_m: float = CELL_M, corner_m: tuple[float, float] = (0.0, 0.0)):
    """A grid all of which was just seen; floor where an obstacle is improbable."""
    origin = (corner_m[0] + cell_m / 2.0, corner_m[1] + cell_m / 2.0)
    obstacle = obstacle.astype(np.float32)
    return FloorGrid(origin, cell_m, obstacle, obstacle < 0.5, np.zeros(obstacle.shape, dtype=np.float32))


def unseen(grid: FloorGrid, x0: float, y0: float, x1: float, y1: float) -> FloorGrid:
    """The same grid, with a rectangle never seen."""
    rows = slice(round(y0 / CELL_M), round(y1 / CELL_M))
    columns = slice(round(x0 / CELL_M), round(x1 / CELL_M))
    obstacle, seen, age = grid.obstacle.copy(), grid.floor.copy(), grid.age_s.copy()
    obstacle[rows, columns], seen[rows, columns], age[rows, columns] = 0.5, False, np.inf
    return FloorGrid(grid.origin_m, grid.cell_m, obstacle, seen, age)
