"""The window around a robot: which cell shows which place, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.floor_grid import FloorGrid
from revnm_server.map_window import LAYERS, WindowSpec, map_window, window_points_m


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
    window = map_window(grid(), pose, np.array([5.05, 1.05]))
    x, y = pose.inverse().apply(np.array([5.05, 1.05]))
    row, column = round(47.5 - x / 0.1), round(47.5 - y / 0.1)
    assert window.layers.shape == (5, 96, 96)
    assert window.layers.dtype == np.float32
    layers = dict(zip(LAYERS, window.layers[:, row, column], strict=True))
    expected = {"obstacle": 0.9, "floor": 1.0, "unseen": 0.0, "age": 0.1, "lidar": 0.5}
    assert layers == pytest.approx(expected, abs=1e-6)
    assert window.goal_distance_m == pytest.approx(math.hypot(1.05, 1.05))
    np.testing.assert_allclose(window.goal_direction * window.goal_distance_m, [x, y])


def test_points_say_the_same():
    points = window_points_m(WindowSpec())
    np.testing.assert_allclose(points[0, 0], [4.75, 4.75])  # farthest ahead, farthest left
    np.testing.assert_allclose(points[95, 0], [-4.75, 4.75])
    pose = Pose2(4.0, 0.0, 0.7)
    window = map_window(grid(), pose, np.zeros(2))
    centre = (points * window.layers[0][..., None] * (window.layers[1] > 0.5)[..., None]).sum(axis=(0, 1))
    centre /= (window.layers[0] * (window.layers[1] > 0.5)).sum()
    np.testing.assert_allclose(pose.apply(centre), [5.05, 1.05], atol=0.03)


def test_off_the_map_nothing_is_known_and_a_goal_underfoot_has_a_direction():
    window = map_window(grid(), Pose2(-30.0, 0.0, 0.0), np.array([-30.0, 0.0]))
    np.testing.assert_allclose(window.layers.reshape(5, -1).min(axis=1), [0.5, 0.0, 1.0, 1.0, 0.5])
    np.testing.assert_allclose(window.layers.reshape(5, -1).max(axis=1), [0.5, 0.0, 1.0, 1.0, 0.5])
    np.testing.assert_array_equal(window.goal_direction, [1.0, 0.0])
    assert window.goal_distance_m == 0.0
