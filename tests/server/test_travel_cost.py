from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_server.planning.travel_cost import CostSettings, travel_cost
from revnm_sim.expert.planner import travel_cost as expert_cost

from .floor_scenes import floor, unseen

SETTINGS = CostSettings()
WALL = (4.0, 0.0, 4.1, 4.0)


def test_near_a_sure_wall_the_cost_is_the_experts():
    cost = travel_cost(floor(8.0, 4.0, WALL), SETTINGS)
    away_m = np.arange(1, 30) * 0.1  # from the wall's column, 40, to the right
    np.testing.assert_allclose(
        cost.sure_m[20, 41:70], np.where(away_m < SETTINGS.inflation_m + 0.01, away_m, np.inf), rtol=1e-6
    )
    np.testing.assert_allclose(cost.per_m[20, 41:70], expert_cost(away_m), rtol=1e-4)
    assert cost.per_m[20, 40] == pytest.approx(
        602.0
    )  # twice the rim's 300 instead of 1, on top of the 3 of floor unseen


def test_a_floor_without_obstacles_costs_its_price():
    grid = floor(3.0, 2.0)
    grid = replace(grid, age_s=np.full((20, 30), 60.0, dtype=np.float32))
    cost = travel_cost(unseen(grid, 2.0, 0.0, 3.0, 2.0), SETTINGS)
    assert cost.per_m[10, 5] == pytest.approx(1.0 + 0.3 * (1.0 - math.exp(-1.0)))
    assert cost.per_m[10, 25] == pytest.approx(3.0)
    assert np.isinf(cost.sure_m).all()


def test_the_likelier_the_dearer():
    dear = [travel_cost(floor(8.0, 4.0, WALL, p=p), SETTINGS) for p in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)]
    at_wall = [cost.per_m[20, 41] for cost in dear]
    assert at_wall[0] == 1.0  # 0.5 is no knowledge: only its floor has a price
    assert (np.diff(at_wall) > 0.0).all()
    assert at_wall[1] < 0.05 * at_wall[-1]
    assert [bool(cost.sure_m[20, 40] == 0.0) for cost in dear] == [False] * 5 + [True]


def test_the_cost_of_a_way_by_hand():
    """Two metres seen, one metre not, half a metre outside of the grid: 2 + 3 + 1.5; the seams blur over a cell."""
    cost = travel_cost(unseen(floor(3.0, 2.0), 2.0, 0.0, 3.0, 2.0), SETTINGS)
    xs = np.linspace(0.0, 3.5, 141)
    way = np.stack([xs, np.full(141, 1.03)], axis=1)
    # Left of the first cell's middle, over 0.05 m, the price falls from the mean of inside and outside, 2, to 1.
    blurred = 0.05 * 0.5
    assert cost.of_way(way) == pytest.approx(6.5 + blurred, abs=0.01)
    assert cost.of_way(way[:1]) == 0.0
