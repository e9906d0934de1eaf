from __future__ import annotations

import numpy as np
import pytest

from revnm_server.planning.travel_cost import CostSettings, travel_cost
from revnm_server.planning.way import at_lengths, bent_to, evenly, farthest_m, length_m, rest_of
from revnm_server.planning.way_smoothing import smooth

from .floor_scenes import floor

CORNER = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])


def test_lengths_and_points_by_hand():
    assert length_m(CORNER) == pytest.approx(3.0)
    points = at_lengths(CORNER, np.array([0.4, 1.0, 1.5, 9.0]))
    np.testing.assert_allclose(points, [[0.4, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 2.0]])
    even = evenly(CORNER, 0.5)
    np.testing.assert_allclose(even, [[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [1, 1.5], [1, 2]])
    np.testing.assert_allclose(evenly(CORNER[:1].repeat(2, axis=0)), [[0, 0], [0, 0]])


def test_bending_shifts_the_beginning_and_fades_out():
    way = evenly(np.array([[0.0, 0.0], [2.0, 0.0]]), 0.5)
    bent = bent_to(way, np.array([0.0, 0.2]), over_m=1.0)
    # A raised cosine over 1 m: all of the shift at 0, half of it at 0.5 m, none from 1 m on.
    np.testing.assert_allclose(bent, [[0, 0.2], [0.5, 0.1], [1, 0], [1.5, 0], [2, 0]], atol=1e-12)
    short = bent_to(way[:2], np.array([0.1, 0.2]), over_m=1.0)
    np.testing.assert_allclose(short, [[0.1, 0.2], [0.5, 0.0]])
    point = bent_to(np.zeros((2, 2)), np.array([0.1, 0.2]), over_m=1.0)
    np.testing.assert_allclose(point, [[0.1, 0.2], [0.0, 0.0]])


def test_the_rest_begins_beside_the_robot_and_never_vanishes():
    way = evenly(CORNER, 0.5)
    np.testing.assert_allclose(rest_of(way, np.array([0.6, 0.3]), within_m=1.5), way[1:])
    np.testing.assert_allclose(rest_of(way, np.array([1.0, 2.0]), within_m=1.5), way[3:])  # looked for so far only
    np.testing.assert_allclose(rest_of(way, np.array([1.0, 2.0]), within_m=9.0), way[-2:])
    assert farthest_m(way, way[:3]) == pytest.approx(2.0)


def test_a_staircase_on_free_floor_becomes_a_straight_line():
    cost = travel_cost(floor(6.0, 6.0), CostSettings())
    steps = np.repeat(np.arange(1.0, 5.0, 0.1), 2)
    staircase = np.stack([steps[1:], steps[:-1]], axis=1)
    way = smooth(staircase, cost)
    np.testing.assert_allclose(way[[0, -1]], staircase[[0, -1]])
    assert length_m(way) == pytest.approx(np.hypot(*(staircase[-1] - staircase[0])), rel=1e-3)


def test_a_smooth_way_is_cheaper_and_turns_gently():
    cost = travel_cost(floor(6.0, 6.0, (2.5, 0.0, 3.5, 3.0)), CostSettings())
    rough = evenly(np.array([[1.0, 1.0], [1.0, 3.9], [5.0, 3.9], [5.0, 1.0]]), 0.1)
    way = smooth(rough, cost)
    assert cost.of_way(way) < cost.of_way(rough)
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(way, axis=0)[:, ::-1].T)))
    assert np.abs(turns).max() < 0.25  # on 0.05 m
    np.testing.assert_allclose(np.hypot(*np.diff(way, axis=0).T), 0.05, atol=2e-3)
