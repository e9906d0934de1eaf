from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.errors import ConfigError
from revnm_sim.expert import Expert
from revnm_sim.generator import TRAINING_SEED_BASE, random_pillar
from revnm_sim.placement import sample_camera
from revnm_sim.raycast import visible
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import (
    Scenario,
    benchmark_scenario,
    demo_scenario,
    free_places,
    sample_pair,
    segment_blocked,
    tag_seen,
    tag_side_px,
)
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays


def distance(scenario: Scenario) -> float:
    return math.dist(scenario.start[:2], scenario.goal_m)


def seen(scenario: Scenario, x: float, y: float, z: float) -> bool:
    arrays = primitive_arrays(scenario.world.primitives)
    return bool(visible(arrays, scenario.camera, np.array([[x, y, z]]))[0])


@pytest.mark.parametrize("index", range(6))
def test_benchmark_trials_are_blocked_and_can_be_solved(index: int) -> None:
    scenario = benchmark_scenario("random_pillar", seed=1000, index=index)
    assert (scenario.camera.width_px, scenario.camera.height_px) == (640, 480)
    assert math.degrees(scenario.camera.hfov_rad) == pytest.approx(120.0)
    assert 5.0 <= distance(scenario) <= 10.0
    expert = Expert(scenario.world)
    start, goal = np.array(scenario.start[:2]), np.array(scenario.goal_m)
    assert segment_blocked(expert.grid, start[None], goal)[0]
    assert expert.grid.clearance_m(np.stack([start, goal])).min() >= 0.35
    assert distance(scenario) < expert.field(goal).length_m(start) <= 20.0
    assert seen(scenario, *scenario.goal_m, 0.0)
    assert seen(scenario, *scenario.start[:2], scenario.robot.top_m)
    assert int(scenario.world.name.rsplit("-", 1)[1]) < TRAINING_SEED_BASE


def test_benchmark_is_the_same_every_time_and_never_twice_the_same() -> None:
    one = benchmark_scenario("random_pillar", seed=5, index=2)
    assert one == benchmark_scenario("random_pillar", seed=5, index=2)
    assert one.world.name != benchmark_scenario("random_pillar", seed=5, index=3).world.name
    assert one.world.name != benchmark_scenario("random_pillar", seed=6, index=2).world.name


def test_unknown_world_is_refused() -> None:
    with pytest.raises(ConfigError, match="'moon'"):
        benchmark_scenario("moon", seed=0, index=0)


@pytest.mark.parametrize("seed", range(5))
def test_demo_keeps_the_tag_large(seed: int) -> None:
    scenario = demo_scenario(seed)
    camera = scenario.camera
    assert (camera.width_px, camera.height_px) == (1280, 960)
    assert 3.0 <= camera.position_m[2] <= 3.5
    assert 2.5 <= distance(scenario) <= 5.0
    grid = Expert(scenario.world).grid
    places = free_places(grid, np.random.default_rng(seed), count=600)
    in_view = places[tag_seen(primitive_arrays(scenario.world.primitives), camera, places, scenario.robot)]
    assert len(in_view) > 0.5 * len(places)
    assert tag_side_px(camera, in_view, scenario.robot).min() >= 20.0
    assert demo_scenario(seed) == scenario


def test_tag_side_is_that_of_the_sighting() -> None:
    scenario = demo_scenario(0)
    place = np.array([scenario.start[:2]])
    pose = scenario.start._replace(yaw_rad=0.0)
    corners = see_robot(scenario.camera, pose, scenario.robot, robot="r", stamp_ns=0).corners
    side = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).mean()
    assert tag_side_px(scenario.camera, place, RobotSpec())[0] == pytest.approx(side, rel=0.05)


def test_segment_is_blocked_where_the_robot_would_touch() -> None:
    pole = Primitive(Shape.CYLINDER, (0.0, 0.0, 0.5), (0.2, 0.2, 1.0), 0.0, (0, 0, 0))
    grid = Expert(World("pole", Bounds(-4, -4, 4, 4), (0, 0, 0), (pole,))).grid
    # Pole 0.1 m + robot 0.22 m: a line that passes 0.25 m beside the pole's middle is blocked, 0.42 m is not.
    starts = np.array([[-3.0, 0.0], [-3.0, 0.25], [-3.0, 0.42]])
    for start, expected in zip(starts, [True, True, False], strict=True):
        assert segment_blocked(grid, start[None], start * [-1.0, 1.0])[0] == expected


def test_training_draws_pairs_of_both_kinds() -> None:
    world = random_pillar(TRAINING_SEED_BASE + 3)
    rng, expert = np.random.default_rng(0), Expert(world)
    camera = sample_camera(world, rng, width_px=640, height_px=480, hfov_rad=2.0)
    pairs = [sample_pair(world, camera, expert, rng, distance_m=(1.0, 6.0), blocked=False) for _ in range(12)]
    blocked = []
    for pair in pairs:
        assert pair is not None
        start, goal = pair
        assert 1.0 <= math.dist(start[:2], goal) <= 6.0
        blocked.append(segment_blocked(expert.grid, np.array([start[:2]]), np.array(goal))[0])
    assert 0 < sum(blocked) < 12
    assert sample_pair(world, camera, expert, rng, distance_m=(50.0, 60.0)) is None
