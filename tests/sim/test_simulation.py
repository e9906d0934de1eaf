from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import Velocity
from revnm_sim.camera import Camera
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import Bounds, Primitive, Shape, World

BOX = Primitive(Shape.BOX, (2.0, 0.0, 0.5), (0.4, 0.6, 1.0), 0.0, (200, 60, 60))
SCENARIO = Scenario(
    world=World("test", Bounds(-5.0, -5.0, 5.0, 5.0), (150, 150, 150), (BOX,)),
    camera=Camera(320, 240, 1.4, (-2.0, 0.0, 2.5), 0.0, 0.7),
    start=Pose2(0.0, 0.0, 0.0),
    goal_m=(3.0, 1.0),
    seed=0,
)


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(SCENARIO, seed=1) as made:
        yield made


def drive(simulation: Simulation, velocity: Velocity, seconds: float) -> None:
    """Repeat a command at 20 Hz, as the robot client does."""
    for _ in range(round(seconds * 20)):
        simulation.command(velocity)
        simulation.advance(0.05)


def test_time_passes_in_ticks_and_no_time_is_lost(simulation: Simulation) -> None:
    simulation.advance(0.05)
    assert simulation.time_ns == 50_000_000
    for _ in range(100):
        simulation.advance(0.033)
    assert simulation.time_ns == 3_350_000_000


def test_commands_move_the_robot_and_the_watchdog_stops_it(simulation: Simulation) -> None:
    drive(simulation, Velocity(0.5, 0.0), 2.0)
    simulation.advance(0.7)
    stood = simulation.true_pose
    simulation.advance(1.0)
    # 50 ms delay, 0.5 s to speed up (0.125 m), 1.45 s at full speed, ≤ 0.25 s watchdog, 0.25 s braking (0.0625 m).
    assert 0.85 < stood.x_m < 1.1
    assert math.dist(stood[:2], simulation.true_pose[:2]) < 1e-3
    assert simulation.path_m == pytest.approx(stood.x_m, abs=0.01)
    assert not simulation.had_contact


def test_collision_is_remembered(simulation: Simulation) -> None:
    assert simulation.closest_m == pytest.approx(1.0)
    drive(simulation, Velocity(0.5, 0.0), 5.0)
    assert simulation.in_contact
    drive(simulation, Velocity(-0.3, 0.0), 3.0)
    assert not simulation.in_contact
    assert simulation.had_contact
    assert simulation.closest_m == pytest.approx(0.0, abs=0.01)
    assert simulation.clearance_m > 0.3
    before = simulation.contacts
    assert before >= 1
    drive(simulation, Velocity(0.5, 0.0), 3.0)
    assert simulation.contacts > before


def test_odometry_follows_within_its_drift(simulation: Simulation) -> None:
    drive(simulation, Velocity(0.4, 0.3), 5.0)
    odometry, truth = simulation.odometry(), simulation.true_pose
    assert odometry.stamp_ns == simulation.time_ns
    assert math.dist(odometry.odom_from_robot[:2], truth[:2]) < 0.06 * simulation.path_m
    assert odometry.odom_from_robot[:2] != pytest.approx(truth[:2], abs=1e-4)
    assert odometry.velocity.v_mps == pytest.approx(0.4, rel=0.06)


def test_scan_sees_the_box_from_where_the_robot_is(simulation: Simulation) -> None:
    assert simulation.scan().ranges_m[360] == pytest.approx(1.8, abs=0.06)
    drive(simulation, Velocity(0.5, 0.0), 2.0)
    assert simulation.scan().ranges_m[360] == pytest.approx(1.8 - simulation.true_pose.x_m, abs=0.06)


def test_picture_follows_the_robot(simulation: Simulation) -> None:
    before = simulation.picture()
    assert before.shape == (240, 320, 3)
    drive(simulation, Velocity(0.5, 0.0), 1.0)
    assert (simulation.picture() != before).any()


def test_equal_seeds_and_commands_give_equal_runs() -> None:
    def run(seed: int) -> tuple[Pose2, Pose2, list[float]]:
        with Simulation(SCENARIO, seed) as simulation:
            drive(simulation, Velocity(0.5, 0.2), 3.0)
            odometry = simulation.odometry().odom_from_robot
            return simulation.true_pose, odometry, simulation.scan().ranges_m.tolist()

    assert run(1) == run(1)
    assert run(1)[0] == run(2)[0]  # the seed is that of the sensors
    assert run(1)[1:] != run(2)[1:]


def test_a_minute_passes_much_faster_than_real_time() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform([2.0, -5.0], [8.0, 5.0], (60, 2))
    pillars = tuple(
        Primitive(Shape(int(i % 2)), (x, y, 0.5), (0.4, 0.4, 1.0), 0.3, (90, 90, 90))
        for i, (x, y) in enumerate(places.tolist())
    )
    world = World("crowded", SCENARIO.world.bounds, (150, 150, 150), pillars)
    scenario = Scenario(world, SCENARIO.camera, Pose2(0.0, 0.0, 0.0), (3.0, 1.0), 0)
    with Simulation(scenario, seed=0) as simulation:
        began = time.process_time()
        drive(simulation, Velocity(0.2, 0.5), 60.0)
        assert time.process_time() - began < 6.0  # about 1 s where nothing else runs


def test_a_walker_is_seen_and_felt_where_it_was_moved_to() -> None:
    walker = Primitive(Shape.CYLINDER, (0.0, 3.0, 0.5), (0.4, 0.4, 1.0), 0.0, (60, 200, 60))
    with Simulation(SCENARIO, seed=1, walker=walker) as simulation:
        simulation.move_walker(np.array([-1.0, 0.0]))  # straight behind, where beam 0 looks
        simulation.advance(0.05)
        assert simulation.scan().ranges_m[0] == pytest.approx(0.8, abs=0.06)
        assert simulation.clearance_m == pytest.approx(1.0 - 0.2 - 0.215, abs=0.01)
        assert not simulation.in_contact
        simulation.move_walker(np.array([-0.4, 0.0]))
        simulation.advance(0.05)
        assert simulation.in_contact
