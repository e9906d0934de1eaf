from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_sim.expert.planner import Expert
from revnm_sim.generation.generator import TRAINING_SEED_BASE, random_pillar
from revnm_sim.generation.placement import sample_camera
from revnm_sim.rays.raycast import visible
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import (
    Scenario,
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


def test_pairs_come_as_they_are_or_with_a_detour() -> None:
    world = random_pillar(TRAINING_SEED_BASE + 3)
    rng, expert = np.random.default_rng(0), Expert(world)
    camera = sample_camera(world, rng, width_px=640, height_px=480, hfov_rad=2.0)
    extra_m = []
    for detour_m in [0.0] * 12 + [1.5] * 3:
        pair = sample_pair(world, expert, rng, detour_m=detour_m, cameras=[camera], distance_m=(1.0, 6.0))
        assert pair is not None
        start, straight_m = np.array(pair.start[:2]), math.dist(pair.start[:2], pair.goal_m)
        assert 1.0 <= straight_m <= 6.0
        extra_m.append(expert.shortest(pair.goal_m).length_m(start) - straight_m)
        arrays = primitive_arrays(world.primitives)
        assert visible(arrays, camera, np.array([[*pair.goal_m, 0.0], [*start, RobotSpec().top_m]])).all()
    assert min(extra_m[:12]) < 0.1
    assert min(extra_m[12:]) >= 1.5
    assert sample_pair(world, expert, rng, detour_m=0.0, distance_m=(50.0, 60.0)) is None
