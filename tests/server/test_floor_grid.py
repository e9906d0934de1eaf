"""The told part of a map: it holds all that is known, and leads the same ways; and layers that nodes carry."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.node_grid import NodeGrid

from .floor_scenes import floor
from .planning import TWO_GAPS, plan, planner

CORNER = (100, 140)  # row and column of the large map where the small one lies


def within(small: FloorGrid, spec: MapSpec) -> FloorGrid:
    """A large map that knows what a small one does, and nothing else."""
    large = spec.unknown()
    rows, columns = small.obstacle.shape
    part = slice(CORNER[0], CORNER[0] + rows), slice(CORNER[1], CORNER[1] + columns)
    large.obstacle[part], large.floor[part], large.age_s[part] = small.obstacle, small.floor, small.age_s
    return large


def test_the_part_holds_what_is_known_and_the_points_and_a_margin():
    large = within(floor(6.0, 4.0), MapSpec())
    far = large.points_m(np.array([[20.0, 200.0]]))
    part = large.told(far)
    assert part.known.sum() == large.known.sum()
    rows, columns = part.obstacle.shape
    assert rows <= 160
    assert columns < 120
    for point in (large.points_m(np.array(CORNER)), far[0]):  # a metre on every side
        row, column = part.cells(point)
        assert 10 <= row < rows - 10
        assert 10 <= column < columns - 10
        near = tuple(np.rint(part.cells(point)).astype(int))
        assert part.obstacle[near] == large.obstacle[tuple(np.rint(large.cells(point)).astype(int))]


def test_a_point_off_the_map_and_an_unknown_map_have_a_part_too():
    unknown = MapSpec().unknown()
    part = unknown.told(np.array([[-50.0, 0.0]]))
    assert part.origin_m[0] == pytest.approx(unknown.origin_m[0])
    assert part.obstacle.size < 0.05 * unknown.obstacle.size


def test_a_part_about_points_has_the_margin_whatever_the_cells_are():
    for cell_m in (0.05, 0.1, 0.25):
        grid = MapSpec(cell_m=cell_m).unknown()
        part = grid.around(np.array([[3.0, 0.0], [5.0, 1.0]]), 1.0)
        (x0, y0), (x1, y1) = part.points_m(np.array([[0.0, 0.0], np.array(part.obstacle.shape) - 1.0]))
        assert 2.0 - 20 * cell_m <= x0 <= 2.0 < 6.0 <= x1 <= 6.0 + 21 * cell_m
        assert -1.0 - 20 * cell_m <= y0 <= -1.0 < 2.0 <= y1 <= 2.0 + 21 * cell_m


@pytest.mark.parametrize("hole_m", [(3.0, 2.0), (5.5, 9.0)])
def test_ways_do_not_depend_on_how_much_unknown_floor_lies_around(hole_m: tuple[float, float]):
    """One goal lies beyond a wall with gaps, the other beyond what was seen."""
    tight, wide = MapSpec(ahead_m=22.0, width_m=21.0), MapSpec(ahead_m=40.0, width_m=40.0)
    room = floor(10.0, 7.0, *((x0 - 1.0, y0, x1 - 1.0, min(y1, 7.0)) for x0, y0, x1, y1 in TWO_GAPS if y0 < 7.0))
    ways = []
    for spec in (tight, wide):
        large = within(room, spec)
        corner = large.points_m(np.array(CORNER))
        start = Pose2(float(corner[0]) + 9.0, float(corner[1]) + 3.0, 0.0)
        found = plan(planner(), large, start, corner + np.array(hole_m))
        assert found.way_m is not None
        ways.append(found.way_m - corner)
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-6)


def test_a_layer_goes_through_its_nodes_and_straight_between():
    grid = NodeGrid((10, 15))
    rows, columns = np.meshgrid(np.arange(10.0), np.arange(15.0), indexing="ij")
    layer = np.stack([2.0 * rows - columns, rows], axis=-1)
    filled = grid.filled(layer[grid.nodes])
    assert layer[grid.nodes].size < layer.size / 4
    np.testing.assert_allclose(filled, layer, atol=1e-4)
