"""The window around a robot: which cell shows which place, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.map_window import LAYERS, WindowSpec, map_window, onto_grid, window_points_m


def grid() -> FloorGrid:
    """14 × 18 m of unseen floor, but for a block of seen obstacle of 0.3 m around (5, 1)."""
    obstacle = np.full((180, 140), 0.5, dtype=np.float32)
    floor = np.zeros((180, 140), dtype=np.bool_)
    age = np.full((180, 140), np.inf, dtype=np.float32)
    found = FloorGrid((0.05, -8.95), 0.1, obstacle, floor, age)
    row, column = np.rint(found.cells(np.array([5.05, 1.05]))).astype(int)
    block = (slice(row - 1, row + 2), slice(column - 1, column + 2))
    obstacle[block], floor[block], age[block] = 0.9, True, 3.0
    return found


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2.0, -2.2])
def test_a_place_appears_where_the_robot_has_it(yaw):
    pose = Pose2(4.0, 0.0, yaw)
    window = map_window(grid(), pose)
    x, y = pose.inverse().apply(np.array([5.05, 1.05]))
    row, column = round(47.5 - x / 0.1), round(47.5 - y / 0.1)
    assert window.shape == (4, 96, 96)
    assert window.dtype == np.float32
    layers = dict(zip(LAYERS, window[:, row, column], strict=True))
    assert layers == pytest.approx({"obstacle": 0.9, "floor": 1.0, "unseen": 0.0, "lidar": 0.5}, abs=1e-6)


def test_points_say_the_same():
    points = window_points_m(WindowSpec())
    np.testing.assert_allclose(points[0, 0], [4.75, 4.75])  # farthest ahead, farthest left
    np.testing.assert_allclose(points[95, 0], [-4.75, 4.75])
    pose = Pose2(4.0, 0.0, 0.7)
    obstacle, floor = map_window(grid(), pose)[:2]
    centre = (points * obstacle[..., None] * (floor > 0.5)[..., None]).sum(axis=(0, 1))
    centre /= (obstacle * (floor > 0.5)).sum()
    np.testing.assert_allclose(pose.apply(centre), [5.05, 1.05], atol=0.03)


def test_off_the_map_nothing_is_known():
    window = map_window(grid(), Pose2(-30.0, 0.0, 0.0)).reshape(4, -1)
    np.testing.assert_allclose(window.min(axis=1), [0.5, 0.0, 1.0, 0.5])
    np.testing.assert_allclose(window.max(axis=1), [0.5, 0.0, 1.0, 0.5])


@pytest.mark.parametrize(("pose", "share"), [(Pose2(7.0, 0.0, 0.7), 1.0), (Pose2(0.0, -9.0, 0.0), 0.25)])
def test_what_is_cut_out_is_drawn_back_onto_the_same_places(pose, share):
    window = map_window(grid(), pose)[0]
    drawn = onto_grid(window, grid(), pose)
    inside = np.isfinite(drawn)
    assert inside.sum() == pytest.approx(share * 9.5**2 / 0.1**2, rel=0.03)  # the corner's lies outside but a quarter
    expected = grid().obstacle[inside]
    assert np.abs(drawn[inside] - expected).mean() < 0.002  # twice interpolated, but at the block's rim
