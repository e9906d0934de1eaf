"""The distance field against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_client.mppi.distance_field import DistanceField, squared_distance


@pytest.mark.parametrize("seed", range(5))
def test_transform_equals_brute_force_up_to_its_reach(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupied = rng.random((40, 40)) < 0.01
    occupied[0, 39] = True
    cells = np.argwhere(np.ones_like(occupied))
    gaps = cells[:, None, :] - np.argwhere(occupied)[None]
    brute = (gaps**2).sum(axis=2).min(axis=1).reshape(occupied.shape)
    reach = 9
    found = squared_distance(occupied, reach)
    near = brute <= reach**2
    np.testing.assert_array_equal(found[near], brute[near])
    assert (found[~near] > reach**2).all()


@pytest.mark.parametrize("reach", [1, 2, 17, 60, 200])
def test_every_reach_on_an_oblong_grid_equals_brute_force(reach: int) -> None:
    occupied = np.zeros((25, 40), dtype=bool)
    occupied[[3, 20], [38, 2]] = True
    y, x = np.indices(occupied.shape)
    brute = np.minimum((y - 3) ** 2 + (x - 38) ** 2, (y - 20) ** 2 + (x - 2) ** 2)
    found = squared_distance(occupied, reach)  # 60 reaches across the grid, 200 needs more than 16 bits
    near = brute <= reach**2
    np.testing.assert_array_equal(found[near], brute[near])
    assert (found[~near] > reach**2).all()


def test_looked_up_distance_is_within_a_cell_of_the_true_one() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-2.0, 2.0, (60, 2))
    field = DistanceField.from_points(points, half_m=2.4, resolution_m=0.04, reach_m=0.7)
    at = rng.uniform(-2.3, 2.3, (3000, 2)).astype(np.float32)
    true = np.hypot(*(at[:, None, :] - points[None]).transpose(2, 0, 1)).min(axis=1)
    # Half a diagonal each for the point and for the query: 2 * 0.04 * sqrt(2) / 2 = 0.0566 m.
    np.testing.assert_allclose(field.at(at[:, 0], at[:, 1]), np.minimum(true, 0.7), atol=0.0567)


def test_without_obstacles_every_distance_is_the_reach() -> None:
    field = DistanceField.from_points(np.empty((0, 2)), half_m=1.0, resolution_m=0.05, reach_m=0.5)
    x = np.linspace(-3.0, 3.0, 50, dtype=np.float32)
    np.testing.assert_allclose(field.at(x, x), 0.5)


def test_points_and_queries_outside_the_grid_do_no_harm() -> None:
    points = np.array([[50.0, 0.0], [-50.0, 3.0], [0.98, 0.0]])
    field = DistanceField.from_points(points, half_m=1.0, resolution_m=0.05, reach_m=0.5)
    x = np.array([9.0, -9.0], dtype=np.float32)
    distance = field.at(x, np.zeros(2, dtype=np.float32))
    assert distance[0] == 0.0  # the border cell right of the origin holds the third point
    assert distance[1] == 0.5
