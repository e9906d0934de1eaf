"""Goals that a soak draws are such that a robot can get there and be seen there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_client.geometry import Pose2
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import INSCRIBED_M
from revnm_sim.generation.placement import distances_m
from revnm_sim.rays.raycast import visible
from revnm_sim.scenario import Scenario, tag_points
from revnm_sim.soak.goals import GoalDraw
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

GRAY = (170, 170, 175)
WALL = Primitive(Shape.BOX, (0.0, 0.0, 0.3), (0.2, 3.0, 0.6), 0.0, GRAY)  # leaves 0.5 m and more at either end
SCENARIO = Scenario(
    world=World("room", Bounds(-3.0, -2.5, 3.0, 2.5), (150, 150, 150), (WALL,)),
    camera=Camera(640, 480, math.radians(75.0), (0.0, 0.0, 4.3), math.pi / 2, math.pi / 2),
    start=Pose2(-2.0, 0.0, 0.0),
    goal_m=(2.0, 0.0),
    seed=0,
)


def test_goals_are_far_clear_seen_and_on_the_floor_of_their_pixel() -> None:
    goals, arrays = GoalDraw(SCENARIO, np.random.default_rng(0)), primitive_arrays(SCENARIO.world.obstacles)
    drawn = [goals.draw((-2.0, 0.0)) for _ in range(30)]
    places = np.array([goal.place_m for goal in drawn])
    assert np.hypot(*(places - (-2.0, 0.0)).T).min() >= 1.5
    at_floor = np.column_stack([places, np.zeros(len(places))])
    assert distances_m(arrays, at_floor).min() > INSCRIBED_M
    assert visible(arrays, SCENARIO.camera, at_floor).all()
    assert visible(arrays, SCENARIO.camera, tag_points(places, SCENARIO.robot).reshape(-1, 3)).all()
    for goal in drawn:
        assert SCENARIO.camera.floor_point(np.array(goal.pixel)) == pytest.approx(goal.place_m, abs=1e-6)


def test_the_limit_is_half_a_minute_and_four_times_the_way_at_full_speed() -> None:
    goals = GoalDraw(SCENARIO, np.random.default_rng(0))
    beyond = next(goal for _ in range(50) if (goal := goals.draw((-2.0, 0.0))).place_m[0] > 1.0)
    assert beyond.way_m > math.dist((-2.0, 0.0), beyond.place_m) + 0.1  # around the wall
    assert beyond.limit_s == pytest.approx(30.0 + 4.0 * beyond.way_m / 0.5)


def test_equal_seeds_draw_equal_goals() -> None:
    first, second, other = (GoalDraw(SCENARIO, np.random.default_rng(seed)).draw((-2.0, 0.0)) for seed in (1, 1, 2))
    assert first == second
    assert first != other


def test_nothing_behind_a_closed_wall_is_a_goal() -> None:
    closed = replace(WALL, size_m=(0.2, 5.2, 0.6))
    goals = GoalDraw(replace(SCENARIO, world=replace(SCENARIO.world, primitives=(closed,))), np.random.default_rng(0))
    assert all(goals.draw((-2.5, -2.0)).place_m[0] < 0.0 for _ in range(20))


def test_a_gap_narrower_than_the_robot_is_no_way() -> None:
    narrow = replace(WALL, centre_m=(0.0, -0.2, 0.3), size_m=(0.2, 4.6, 0.6))  # 0.4 m at one end: less than 2 × 0.22
    goals = GoalDraw(replace(SCENARIO, world=replace(SCENARIO.world, primitives=(narrow,))), np.random.default_rng(0))
    assert all(goals.draw((-2.5, -2.0)).place_m[0] < 0.0 for _ in range(20))


def test_where_no_goal_is_it_says_from_where() -> None:
    cell = tuple(
        Primitive(Shape.BOX, (x, y, 0.3), (dx, dy, 0.6), 0.0, GRAY)
        for x, y, dx, dy in (
            (-1.5, 0.0, 0.1, 1.0),
            (-2.5, 0.0, 0.1, 1.0),
            (-2.0, 0.5, 1.0, 0.1),
            (-2.0, -0.5, 1.0, 0.1),
        )
    )
    goals = GoalDraw(replace(SCENARIO, world=replace(SCENARIO.world, primitives=cell)), np.random.default_rng(0))
    with pytest.raises(ContractError, match=r"no goal can be reached from \(-2.00, 0.00\) m"):
        goals.draw((-2.0, 0.0))
