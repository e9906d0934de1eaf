from __future__ import annotations

import numpy as np
import pytest

from revnm_server.planning.floor_graph import FloorGraph


def test_on_free_floor_the_cost_is_the_length_of_sixteen_directions():
    least = FloorGraph((30, 40)).to_cell(np.ones((30, 40)), (5, 7)).potential
    assert least[5, 7] == 0.0
    assert least[5, 30] == pytest.approx(23.0)
    assert least[15, 17] == pytest.approx(10.0 * np.sqrt(2.0))
    assert least[15, 27] == pytest.approx(10.0 * np.sqrt(5.0))
    rows, columns = np.indices((30, 40))
    straight = np.hypot(rows - 5, columns - 7)
    assert (least >= straight - 1e-9).all()
    assert (least <= 1.03 * straight + 1e-9).all()  # the worst direction of sixteen: 2.7 %


def test_a_move_costs_the_mean_of_the_cells_it_touches():
    cost = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    graph = FloorGraph((2, 3))
    assert graph.to_cell(cost, (0, 0)).potential[0, 1] == pytest.approx(1.5)
    # Diagonally over the corners (0, 1) and (1, 0): (1 + 5 + 2 + 4) / 4 · √2 = 4.24 < 1.5 + 3.5.
    assert graph.to_cell(cost, (0, 0)).potential[1, 1] == pytest.approx(3.0 * np.sqrt(2.0))
    # To (1, 2) over (0, 1): 1.5 + (2 + 6 + 3 + 5) / 4 · √2 = 7.16; in one move (1 + 2 + 5 + 6) / 4 · √5 = 7.83.
    assert graph.to_cell(cost, (0, 0)).potential[1, 2] == pytest.approx(1.5 + 4.0 * np.sqrt(2.0))
    # And as dear in the other direction.
    assert graph.to_cell(cost, (1, 2)).potential[0, 0] == pytest.approx(1.5 + 4.0 * np.sqrt(2.0))


def test_no_move_leaves_the_grid_or_cuts_the_corner_of_a_closed_cell():
    cost = np.ones((6, 6))
    cost[np.arange(6), np.arange(6)] = np.inf  # a wall of cells that touch at corners only
    least = FloorGraph((6, 6)).to_cell(cost, (5, 0)).potential
    lower = np.tril(np.ones((6, 6), dtype=bool), -1)
    assert np.isfinite(least[lower]).all()
    assert np.isinf(least[~lower]).all()


def test_cells_lead_from_start_to_goal_by_the_way_they_cost():
    rng = np.random.default_rng(0)
    cost = rng.uniform(1.0, 5.0, (20, 25))
    graph = FloorGraph((20, 25))
    found = graph.to_cell(cost, (2, 3))
    cells = found.cells_from((18, 22))
    assert cells[0].tolist() == [18, 22]
    assert cells[-1].tolist() == [2, 3]
    assert np.abs(np.diff(cells, axis=0)).max() <= 2
    drops = -np.diff(found.potential[cells[:, 0], cells[:, 1]])
    assert (drops > 0.0).all()
    assert drops.sum() == pytest.approx(found.potential[18, 22])


def test_a_limit_leaves_out_what_costs_more_and_a_new_search_forgets_the_old():
    graph = FloorGraph((10, 10))
    first = graph.to_cell(np.ones((10, 10)), (0, 0), limit=4.0)
    assert np.isfinite(first.potential[0, 4])
    assert np.isinf(first.potential[0, 5])
    assert graph.to_cell(np.full((10, 10), 2.0), (0, 0)).potential[0, 9] == pytest.approx(18.0)
