from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_sim.expert.planner import INSCRIBED_M, Expert, UnreachableError, travel_cost
from revnm_sim.generation.generator import random_pillar
from revnm_sim.world import Bounds, Primitive, Shape, World

GREY = (128, 128, 128)
BOUNDS = Bounds(-5.0, -5.0, 5.0, 5.0)


def box(x: float, y: float, length: float, width: float) -> Primitive:
    return Primitive(Shape.BOX, (x, y, 0.5), (length, width, 1.0), 0.0, GREY)


@pytest.fixture(scope="module")
def plane() -> Expert:
    return Expert(World("plane", BOUNDS, GREY, ()))


@pytest.fixture(scope="module")
def walled() -> Expert:
    """A wall along y = 0 from the left side to x = 2; everything must pass on its right."""
    return Expert(World("wall", BOUNDS, GREY, (box(-1.5, 0.0, 7.0, 0.2),)))


def test_potential_of_a_free_plane_is_the_distance(plane: Expert) -> None:
    goal = np.array([0.32, -0.47])
    field = plane.field(goal)
    rows, columns = np.nonzero(plane.grid.distance_m > 0.75)
    middles = (np.stack([columns, rows], axis=1) + 0.5) * 0.05 + np.array(plane.grid.origin_m)
    distance = np.hypot(*(middles - goal).T)
    error = np.abs(field.potential[rows, columns] - distance)
    assert (error <= 0.02 * distance + 1e-9).all()


def test_potential_grows_at_the_travel_cost_along_a_corridor() -> None:
    """In the middle of a corridor of 0.8 m the nearest walls are 0.4 m away, all along."""
    expert = Expert(World("corridor", Bounds(-5.0, -0.4, 5.0, 0.4), GREY, ()))
    potential = expert.field((-4.0, 0.025)).potential
    row = 2 + 8  # 2 cells of rim, 8 from wall to middle
    metre = np.diff(potential[row, 2 + 60 : 2 + 161 : 20])
    assert metre == pytest.approx(np.full(5, travel_cost(np.array(0.4))), rel=0.02)


def test_travel_cost_follows_the_inflation_layer() -> None:
    cost = travel_cost(np.array([0.0, 0.05, 0.22, 0.23, 0.5, 0.70, 3.0]))
    assert np.isinf(cost[0])
    assert cost[1] > cost[2] > 100.0
    # Just outside the inscribed radius Nav2 has 252: 1 + 252 · 0.8 / 50 = 5.03, and it decays from there.
    assert 4.5 < cost[3] < 5.04
    assert 1.0 < cost[4] < cost[3]
    assert cost[5:] == pytest.approx(1.0)


def test_path_in_the_open_is_straight(plane: Expert) -> None:
    field = plane.field((3.0, 2.0))
    path = field.path((-3.0, -2.5))
    length = math.hypot(6.0, 4.5)
    assert path[0] == pytest.approx([-3.0, -2.5])
    assert path[-1] == pytest.approx([3.0, 2.0])
    assert np.hypot(*np.diff(path, axis=0)[:-1].T) == pytest.approx(0.05, rel=0.02)
    assert field.length_m((-3.0, -2.5)) == pytest.approx(length, rel=0.005)
    normal = np.array([-4.5, 6.0]) / length
    assert np.abs((path - path[0]) @ normal).max() < 0.05


def test_path_goes_round_a_wall(walled: Expert) -> None:
    field = walled.field((-3.0, 2.0))
    path = field.path((-3.0, -2.0))
    assert path[:, 0].max() > 2.2
    assert walled.grid.clearance_m(path).min() > INSCRIBED_M
    # Round the corner (2, ±0.1) with the inscribed radius is the shortest that the robot can do.
    shortest = 2.0 * math.hypot(5.22, 1.9)
    assert shortest < field.length_m((-3.0, -2.0)) < 1.2 * shortest
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(path, axis=0)[:-1, ::-1].T)))
    assert np.abs(turns).max() < 0.45


def test_two_ways_of_one_length_are_both_fine() -> None:
    """On the ridge straight behind a box either side is right; the path must take one of them."""
    expert = Expert(World("ridge", BOUNDS, GREY, (box(0.0, 0.0, 1.0, 3.0),)))
    path = expert.field((3.025, 0.025)).path((-3.025, 0.025))
    assert path[-1] == pytest.approx([3.025, 0.025])
    assert expert.grid.clearance_m(path).min() > INSCRIBED_M


def test_a_robot_too_near_to_a_wall_is_led_out(walled: Expert) -> None:
    start = np.array([-2.0, -0.2])  # 0.1 m from the wall
    field = walled.field((-3.0, 2.0))
    assert field.reachable(start[None])[0]
    path = field.path(start)
    away = walled.grid.clearance_m(path)
    assert (away[np.argmax(away > INSCRIBED_M) :] > INSCRIBED_M - 0.03).all()
    assert np.argmax(away > INSCRIBED_M) <= 6  # out of the zone within 0.3 m
    first = field.waypoints(Pose2(-2.0, -0.2, 0.0), count=1, spacing_m=0.1)[0]
    assert first[1] < -0.08


def test_what_cannot_be_reached() -> None:
    cell = (box(3.0, 2.0, 2.2, 0.2), box(3.0, 4.0, 2.2, 0.2), box(2.0, 3.0, 0.2, 2.2), box(4.0, 3.0, 0.2, 2.2))
    # A slit of 0.3 m, too narrow for the robot.
    slit = (box(-4.0, 0.0, 2.0, 0.2), box(1.15, 0.0, 7.7, 0.2))
    expert = Expert(World("cell", BOUNDS, GREY, (*cell, *slit)))
    field = expert.field((0.0, 3.0))
    points = np.array([[3.0, 3.0], [-3.0, -3.0], [2.0, 3.0], [7.0, 0.0], [-3.0, 3.0]])
    assert field.reachable(points).tolist() == [False, False, False, False, True]
    waypoints = field.waypoints_batch(np.column_stack([points, np.zeros(5)]), count=5, spacing_m=0.4)
    assert np.isnan(waypoints).all(axis=(1, 2)).tolist() == [True, True, True, True, False]
    with pytest.raises(UnreachableError, match=r"no way from \(3\.00, 3\.00\) m"):
        field.path((3.0, 3.0))
    with pytest.raises(UnreachableError, match="no way"):
        field.waypoints(Pose2(3.0, 3.0, 0.0), count=5, spacing_m=0.4)
    with pytest.raises(UnreachableError, match=r"goal .* is in an obstacle"):
        expert.field((2.0, 3.0))


def test_waypoints_are_in_the_robot_frame_at_equal_lengths(plane: Expert) -> None:
    field = plane.field((2.0, 1.0))
    pose = Pose2(2.0, -1.1, math.pi / 2)  # the goal is 2.1 m straight ahead
    waypoints = field.waypoints(pose, count=5, spacing_m=0.4)
    assert waypoints == pytest.approx(np.array([[0.4, 0], [0.8, 0], [1.2, 0], [1.6, 0], [2.0, 0]]), abs=0.01)
    near = field.waypoints(Pose2(2.0, 0.5, 0.0), count=4, spacing_m=0.3)
    assert near == pytest.approx(np.array([[0, 0.3], [0, 0.5], [0, 0.5], [0, 0.5]]), abs=0.01)


def test_batch_and_path_agree() -> None:
    world = random_pillar(5)
    expert = Expert(world)
    rng = np.random.default_rng(0)
    places = rng.uniform(world.bounds[:2], world.bounds[2:], (60, 2))
    places = places[expert.grid.clearance_m(places) > 0.3]
    field = expert.field(places[0])
    poses = np.column_stack([places, rng.uniform(-3.0, 3.0, len(places))])[1:]
    batch = field.waypoints_batch(poses, count=5, spacing_m=0.4)
    for pose, waypoints in zip(poses, batch, strict=True):
        frame = Pose2(*pose)
        path = field.path(pose[:2])
        on_path = np.hypot(*(frame.apply(waypoints)[:, None] - path).transpose(2, 0, 1)).min(axis=1)
        assert on_path.max() < 0.03
        assert expert.grid.clearance_m(path).min() > INSCRIBED_M
