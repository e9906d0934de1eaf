"""The benchmark method bev: a trial that begins with an unknown camera, and the detector's stand-in."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2
from revnm_sim.bench.methods.pose import NoisySightings
from revnm_sim.bench.protocol import draw_setting
from revnm_sim.bench.trial import TrialKey, run_trial
from revnm_sim.camera import Camera
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import Bounds, Primitive, Shape, World


def test_it_arrives_though_it_knows_nothing_of_the_camera_and_something_is_in_the_way():
    # Going straight, the robot stands in a pocket here until time runs out.
    setting = draw_setting("random_pillar", seed=5000, pair=5, cameras=2, rule="blocked")
    assert setting.route.blocked
    key = TrialKey(
        world="random_pillar",
        method="bev",
        perception="truth",
        seed=5000,
        pair=5,
        camera=0,
        repeat=0,
        cameras=2,
        rule="blocked",
        world_sha256="",
        bundle="",
        manifest_sha256="",
    )
    result = run_trial(key)
    assert result.success
    assert result.path_m < 1.3 * result.expert_m


CAMERA = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 2.5), 0.0, math.radians(30.0))
BOUNDS = Bounds(-1.0, -5.0, 9.0, 5.0)
SCREEN = Primitive(Shape.BOX, (2.5, 0.0, 0.7), (0.1, 2.0, 1.4), 0.0, (90, 90, 90))


def scenario(*obstacles: Primitive) -> Scenario:
    world = World("w", BOUNDS, (200, 200, 200), obstacles)
    return Scenario(world, CAMERA, Pose2(4.0, 0.0, 0.4), (6.0, 0.0), seed=1)


def test_the_detectors_stand_in_reports_corners_with_half_a_pixel_of_noise():
    place = scenario()
    with Simulation(place, 1) as simulation:
        source = NoisySightings(place, simulation)
        found = [source.sightings(stamp)[0] for stamp in range(200)]
        exact = see_robot(CAMERA, simulation.true_pose, RobotSpec(), robot="rover", stamp_ns=0)
    off = np.stack([sighting.corners for sighting in found]) - exact.corners
    assert 0.45 < off.std() < 0.55
    assert abs(off.mean()) < 0.05
    centre = np.mean([sighting.pixel for sighting in found], axis=0)
    np.testing.assert_allclose(centre, exact.pixel, atol=0.1)


def test_it_reports_nothing_while_the_tag_is_hidden():
    place = scenario(SCREEN)
    with Simulation(place, 1) as simulation:
        assert NoisySightings(place, simulation).sightings(0) == []
