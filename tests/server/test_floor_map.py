"""The lifted picture in the grid: places by hand, scenes by the simulator's ray caster."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_client.geometry import Pose2
from revnm_server.mapping import floor_map
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import Body, FloorMapper, MapSpec
from revnm_server.mapping.lift import FloorLifter, Lifted
from revnm_server.mapping.robot_mask import robot_mask
from revnm_sim.rays.raycast import cast_ids, robot_primitive
from revnm_sim.robot import RobotSpec
from revnm_sim.world import primitive_arrays

from .floor_scene import EYE, HW, OURS, box, disparity, everywhere, view, wall

FRESH = np.zeros(HW, dtype=np.float32)


def drawn(picture, *, covariance=None, bodies=(), age_s=FRESH, spec=None) -> FloorGrid:
    floor = view(OURS, covariance)
    lifted = FloorLifter(floor).lift(picture, everywhere())
    assert isinstance(lifted, Lifted), lifted
    return FloorMapper(floor, spec).draw(lifted, age_s, bodies)


def cell(grid: FloorGrid, x: float, y: float) -> tuple[int, int]:
    row, column = np.rint(grid.cells(np.array([x, y]))).astype(int)
    return int(row), int(column)


def test_a_box_fills_its_cells_and_hides_those_behind():
    # Its near face stands at x = 3.77; it is 0.6 m high, the eye 2.5 m: it hides the floor from its far edge at
    # 4.23 m to 4.23 · 2.5 / 1.9 = 5.57 m.
    grid = drawn(disparity(box(4.0, 0.0, side=0.46), wall(9.0)))
    assert grid.obstacle[cell(grid, 3.76, 0.0)] > 0.9
    assert 0.65 < grid.obstacle[cell(grid, 4.0, 0.1)] < 0.75  # its top alone: there could be room below
    behind = [cell(grid, x, 0.0) for x in (4.55, 4.85, 5.15)]
    assert all(not grid.known[place] and grid.obstacle[place] == 0.5 for place in behind)
    before, beyond, beside = cell(grid, 3.45, 0.0), cell(grid, 6.15, 0.0), cell(grid, 4.0, 1.05)
    assert all(grid.floor[place] and grid.obstacle[place] < 0.45 for place in (before, beyond, beside))


def test_far_floor_and_far_walls_have_no_gaps():
    # At 9 m rows are more than 0.5 m of floor apart, columns 0.15 m.
    grid = drawn(disparity(wall(9.0)))
    line = [cell(grid, x, 0.35) for x in np.arange(2.05, 8.3, 0.1)]
    assert all(grid.floor[place] for place in line)
    near = np.array([[max(grid.obstacle[cell(grid, x, y)] for x in (8.95, 9.05))] for y in np.arange(-4.0, 4.0, 0.1)])
    assert (near > 0.5).all()


def test_what_hangs_leaves_the_floor_below_it_free():
    grid = drawn(disparity(box(4.0, 0.0, side=0.4, height=0.2, bottom=1.8), wall(9.0)))
    seen_below = cell(grid, 4.0, 0.0)
    assert grid.floor[seen_below]
    assert grid.obstacle[seen_below] < 0.5


def test_covariance_spreads_far_obstacles_farther():
    pitch = np.zeros((5, 5))
    pitch[1, 1] = math.radians(1.0) ** 2
    things = (box(3.0, -1.5, side=0.3), box(7.0, 1.5, side=0.3), wall(12.0))
    exact, unsure = drawn(disparity(*things)), drawn(disparity(*things), covariance=pitch)

    def more(x: float, y: float) -> int:
        row, column = cell(exact, x, y)
        window = (slice(row - 8, row + 9), slice(column - 8, column + 9))
        return int((unsure.obstacle[window] > 0.5).sum() - (exact.obstacle[window] > 0.5).sum())

    assert 0 <= more(3.0, -1.5) < more(7.0, 1.5)


def test_the_age_of_a_cell_is_that_of_its_pixels():
    age = FRESH.copy()
    age[:, : HW[1] // 2] = 4.0  # the left half of the picture: y > 0
    grid = drawn(disparity(wall(9.0)), age_s=age)
    assert grid.age_s[cell(grid, 4.0, 1.05)] == pytest.approx(4.0)
    assert grid.age_s[cell(grid, 4.0, -1.05)] == 0.0
    assert np.isinf(grid.age_s[cell(grid, 12.0, 0.0)])  # behind the wall


def test_the_robots_own_body_is_removed():
    pose, spec = Pose2(3.5, 0.4, 0.6), RobotSpec()
    body = Body(pose, spec.length_m, spec.width_m, spec.top_m)
    picture = disparity(robot_primitive(pose, spec), wall(9.0))
    there, gone = drawn(picture), drawn(picture, bodies=(body,))
    place = cell(gone, 3.5, 0.4)
    assert there.obstacle[place] > 0.5
    assert gone.obstacle[place] < 0.1
    assert gone.floor[place]
    assert gone.age_s[place] == 0.0


def test_the_mask_covers_the_robot_and_little_more():
    pose, spec = Pose2(3.5, 0.4, 0.6), RobotSpec()
    body = Body(pose, spec.length_m, spec.width_m, spec.top_m)
    arrays = primitive_arrays((robot_primitive(pose, spec),))
    seen = cast_ids(arrays, EYE, HW)[1] == 0
    tight, wide = robot_mask(view(), (body,), grow_px=1), robot_mask(view(), (body,))
    assert (tight >= seen).all()
    assert (wide >= tight).all()
    assert wide.sum() < 4.0 * seen.sum()
    behind = Body(Pose2(-2.0, 0.0, 0.0), 0.4, 0.4, 0.2)
    assert not robot_mask(view(), (behind,)).any()


def test_the_map_has_the_asked_size():
    grid = drawn(disparity(wall(9.0)), spec=MapSpec(ahead_m=6.0, behind_m=1.0, width_m=4.0))
    assert grid.obstacle.shape == grid.floor.shape == grid.age_s.shape == (40, 70)
    np.testing.assert_allclose(grid.points_m(np.array([0, 0])), [-0.95, -1.95])


@pytest.mark.parametrize(
    "place_m",
    [(0.0, 0.0), (-3.0, 2.0), (-9.0, 2.0), (29.99, 8.99), (50.0, 0.0), (5.0, 11.99), (5.0, 40.0), (5.0, -40.0)],
)
def test_a_body_at_or_beyond_the_edge_of_the_map_is_no_trouble(place_m: tuple[float, float]):
    body = Body(Pose2(*place_m, 1.0), 0.43, 0.36, 0.14)
    with_it, without = drawn(disparity(wall(9.0)), bodies=(body,)), drawn(disparity(wall(9.0)))
    changed = np.argwhere((with_it.age_s != without.age_s) | (with_it.floor != without.floor))
    apart = np.hypot(*(with_it.points_m(changed.astype(np.float64)) - place_m).T)
    assert apart.max(initial=0.0) < 0.4
    assert len(changed) or not without.covers(np.array(place_m))


def test_the_cells_within_reach_are_all_that_anything_is_drawn_in(monkeypatch: pytest.MonkeyPatch):
    part = drawn(disparity(wall(9.0)))
    monkeypatch.setattr(
        floor_map, "_within_reach", lambda view, spec: (slice(0, spec.shape[0]), slice(0, spec.shape[1]))
    )
    whole = drawn(disparity(wall(9.0)))
    np.testing.assert_allclose(part.obstacle, whole.obstacle, atol=1e-6)
    np.testing.assert_array_equal(part.floor, whole.floor)
    np.testing.assert_array_equal(part.age_s, whole.age_s)


def test_times_of_another_size_are_refused():
    floor = view()
    lifted = FloorLifter(floor).lift(disparity(wall(9.0)), everywhere())
    assert isinstance(lifted, Lifted)
    with pytest.raises(ContractError, match="age"):
        FloorMapper(floor).draw(lifted, np.zeros((2, 2), dtype=np.float32))
