from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_sim.occupancy import occupancy
from revnm_sim.world import Bounds, Primitive, Shape, World

GREY = (128, 128, 128)


def world(*primitives: Primitive) -> World:
    return World("test", Bounds(-2.0, -1.5, 2.0, 1.5), GREY, primitives)


def touched(primitive: Primitive, x: float, y: float, resolution: float) -> bool:
    """Ask a fine lattice over the cell whether any of it lies in the footprint."""
    steps = (np.arange(41) / 40 - 0.5) * resolution
    dx, dy = np.meshgrid(x + steps - primitive.centre_m[0], y + steps - primitive.centre_m[1])
    if primitive.shape is Shape.CYLINDER:
        return bool((np.hypot(dx, dy) < primitive.size_m[0] / 2).any())
    c, s = math.cos(primitive.yaw_rad), math.sin(primitive.yaw_rad)
    along, across = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
    return bool(((along < primitive.size_m[0] / 2) & (across < primitive.size_m[1] / 2)).any())


@pytest.mark.parametrize(
    "primitive",
    [
        Primitive(Shape.BOX, (0.3, -0.2, 0.5), (0.9, 0.35, 1.0), 0.6, GREY),
        Primitive(Shape.BOX, (-0.41, 0.17, 0.5), (1.3, 0.02, 1.0), -1.1, GREY),
        Primitive(Shape.CYLINDER, (0.11, 0.23, 0.5), (0.52, 0.52, 1.0), 0.0, GREY),
        Primitive(Shape.CYLINDER, (0.13, 0.27, 0.5), (0.01, 0.01, 1.0), 0.0, GREY),
    ],
)
def test_cells_that_a_footprint_touches_are_occupied(primitive: Primitive) -> None:
    grid = occupancy(world(primitive), resolution_m=0.1)
    rows, columns = grid.occupied.shape
    expected = np.ones_like(grid.occupied)
    for row in range(2, rows - 2):
        for column in range(2, columns - 2):
            x, y = (np.array([column, row]) + 0.5) * 0.1 + np.array(grid.origin_m)
            expected[row, column] = touched(primitive, x, y, 0.1)
    # A lattice may miss a sliver of footprint in the corner of a cell, never the other way round.
    assert not (expected & ~grid.occupied).any()
    assert (grid.occupied & ~expected).sum() <= 2


def test_only_what_reaches_into_the_heights_counts() -> None:
    def box(low: float, high: float) -> Primitive:
        return Primitive(Shape.BOX, (0.0, 0.0, (low + high) / 2), (0.5, 0.5, high - low), 0.0, GREY)

    def free(primitive: Primitive) -> bool:
        return bool(occupancy(world(primitive)).clearance_m(np.zeros(2)) > 0.0)

    assert free(box(0.45, 2.0))  # a table top: driven under
    assert free(box(0.0, 0.01))  # a mat: driven over
    assert not free(box(0.35, 2.0))
    assert not free(box(0.0, 0.05))


def test_outside_the_bounds_is_occupied() -> None:
    grid = occupancy(world())
    assert grid.clearance_m(np.array([2.01, 0.0])) == 0.0
    assert grid.clearance_m(np.array([0.0, -50.0])) == 0.0
    assert grid.occupied[0].all()
    assert grid.occupied[:, -1].all()
    assert grid.occupied.shape == (60 + 4, 80 + 4)


def test_clearance_is_the_distance_to_the_nearest_surface() -> None:
    grid = occupancy(world(Primitive(Shape.CYLINDER, (0.0, 0.0, 0.5), (0.6, 0.6, 1.0), 0.0, GREY)))
    points = np.random.default_rng(0).uniform([-2.0, -1.5], [2.0, 1.5], (500, 2))
    to_wall = np.minimum(2.0 - np.abs(points[:, 0]), 1.5 - np.abs(points[:, 1]))
    to_disc = np.hypot(*points.T) - 0.3
    expected = np.maximum(np.minimum(to_wall, to_disc), 0.0)
    # Half a diagonal of a cell at either end.
    assert np.abs(grid.clearance_m(points) - expected).max() < 0.05 * math.sqrt(2.0) + 1e-9
