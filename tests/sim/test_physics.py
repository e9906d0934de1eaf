from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Velocity
from revnm_sim.physics import CLEARANCE_LIMIT_M, TICK_NS, Physics
from revnm_sim.robot import RobotSpec
from revnm_sim.robot_model import WHEEL_RADIUS_M
from revnm_sim.world import Bounds, Primitive, Shape, World

BOX = Primitive(Shape.BOX, (2.0, 0.0, 0.5), (0.4, 0.6, 1.0), 0.0, (200, 60, 60))
PILLAR = Primitive(Shape.CYLINDER, (0.0, 3.0, 0.5), (0.5, 0.5, 1.0), 0.0, (60, 200, 60))
WORLD = World("test", Bounds(-5.0, -5.0, 5.0, 5.0), (150, 150, 150), (BOX, PILLAR))
PER_SECOND = 1_000_000_000 // TICK_NS


@pytest.fixture
def physics() -> Iterator[Physics]:
    with Physics(WORLD, Pose2(-1.0, -1.0, 0.3), RobotSpec()) as made:
        yield made


def run(physics: Physics, velocity: Velocity, seconds: float) -> tuple[float, float]:
    """Drive for some seconds; return the length of the path and the turn."""
    physics.drive(velocity)
    length = turn = 0.0
    before = physics.world_from_robot
    for _ in range(round(seconds * PER_SECOND)):
        physics.tick()
        now = physics.world_from_robot
        length += math.hypot(now.x_m - before.x_m, now.y_m - before.y_m)
        turn += math.remainder(now.yaw_rad - before.yaw_rad, math.tau)
        before = now
    return length, turn


def speed_up(physics: Physics) -> float:
    """Speed up to 0.5 m/s at 1 m/s², as the base does, and drive on for 2 s; return the length of the path."""
    lengths = [run(physics, Velocity(0.5 * step / 40, 0.0), 0.0125)[0] for step in range(40)]
    return sum(lengths) + run(physics, Velocity(0.5, 0.0), 2.0)[0]


@pytest.mark.parametrize(
    "velocity",
    [Velocity(0.5, 0.0), Velocity(0.0, 0.7), Velocity(0.5, 0.7), Velocity(0.2, -0.5), Velocity(-0.3, 0.1)],
)
def test_velocities_are_tracked_within_two_percent(physics: Physics, velocity: Velocity) -> None:
    run(physics, velocity, 0.5)
    length, turn = run(physics, velocity, 2.0)
    assert length / 2.0 == pytest.approx(abs(velocity.v_mps), rel=0.02, abs=1e-3)
    assert turn / 2.0 == pytest.approx(velocity.w_radps, rel=0.02, abs=1e-3)


def test_robot_drives_along_its_heading(physics: Physics) -> None:
    speed_up(physics)
    pose = physics.world_from_robot
    moved = np.array([pose.x_m + 1.0, pose.y_m + 1.0])
    assert math.atan2(moved[1], moved[0]) == pytest.approx(0.3, abs=0.01)


def test_positive_turn_is_counter_clockwise(physics: Physics) -> None:
    run(physics, Velocity(0.0, 0.5), 1.0)
    assert physics.world_from_robot.yaw_rad > 0.6


def test_standing_robot_does_not_creep(physics: Physics) -> None:
    run(physics, STANDSTILL, 10.0)
    pose = physics.world_from_robot
    assert math.hypot(pose.x_m + 1.0, pose.y_m + 1.0) < 1e-3
    assert pose.yaw_rad == pytest.approx(0.3, abs=1e-3)


def test_robot_stops_within_a_tenth_of_a_second_when_its_wheels_do(physics: Physics) -> None:
    run(physics, Velocity(0.5, 0.0), 1.0)
    run(physics, STANDSTILL, 0.1)
    assert run(physics, STANDSTILL, 0.5)[0] < 1e-3


def test_wheel_angles_match_the_path(physics: Physics) -> None:
    length = speed_up(physics)
    left, right = physics.wheel_angles_rad
    assert left * WHEEL_RADIUS_M == pytest.approx(length, rel=0.01)
    assert right == pytest.approx(left, rel=1e-3)


def test_equal_commands_give_equal_poses() -> None:
    poses = []
    for _ in range(2):
        with Physics(WORLD, Pose2(0.5, 0.0, 0.0), RobotSpec()) as physics:
            run(physics, Velocity(0.5, 0.05), 4.0)  # into the box, so that contacts count too
            poses.append(physics.world_from_robot)
    assert poses[0] == poses[1]


def test_instances_do_not_disturb_each_other(physics: Physics) -> None:
    with Physics(WORLD, Pose2(-1.0, -1.0, 0.3), RobotSpec()) as other:
        run(other, Velocity(0.5, 0.0), 0.5)
    run(physics, STANDSTILL, 0.5)
    assert physics.world_from_robot.x_m == pytest.approx(-1.0, abs=1e-3)


def test_contact_begins_when_the_body_meets_the_box() -> None:
    # The box begins at x = 1.8, the body ends 0.215 m before the robot's middle: they meet at x = 1.585.
    with Physics(WORLD, Pose2(1.0, 0.0, 0.0), RobotSpec()) as physics:
        physics.drive(Velocity(0.4, 0.0))
        while not physics.in_contact:
            assert physics.world_from_robot.x_m < 1.6
            physics.tick()
        assert physics.world_from_robot.x_m == pytest.approx(1.585, abs=0.008)
        run(physics, Velocity(0.4, 0.0), 1.0)
        assert physics.world_from_robot.x_m < 1.6  # the box stands firm


def test_driving_past_closely_is_no_contact() -> None:
    # The box reaches to y = 0.3, the body 0.18 m to the side of its middle: 1 cm between them.
    with Physics(WORLD, Pose2(1.5, 0.49, 0.0), RobotSpec()) as physics:
        physics.drive(Velocity(0.4, 0.0))
        for _ in range(PER_SECOND):
            physics.tick()
            assert not physics.in_contact
        assert physics.clearance_m == pytest.approx(0.01, abs=0.003)


@pytest.mark.parametrize(
    ("pose", "clearance_m"),
    [
        (Pose2(1.0, 0.0, 0.0), 0.585),  # 1.8 − 1.0 − 0.43 / 2
        (Pose2(1.0, 0.0, math.pi / 2), 0.62),  # 1.8 − 1.0 − 0.36 / 2
        (Pose2(0.0, 2.0, 0.0), 0.57),  # 3 − 0.25 − 2 − 0.36 / 2
        (Pose2(-4.0, -4.0, 0.0), CLEARANCE_LIMIT_M),
    ],
)
def test_clearance_is_measured_from_the_body(pose: Pose2, clearance_m: float) -> None:
    with Physics(WORLD, pose, RobotSpec()) as physics:
        assert physics.clearance_m == pytest.approx(clearance_m, abs=0.005)


def hung(clear_m: float) -> World:
    """Return a world with a board, as thick as wide, that hangs ``clear_m`` over the robot's top ahead of it."""
    bottom = RobotSpec().top_m + clear_m
    board = Primitive(Shape.BOX, (0.6, 0.0, bottom + 0.2), (0.4, 2.0, 0.4), 0.0, (90, 90, 90))
    return World("board", WORLD.bounds, WORLD.floor_colour, (board,))


def test_robot_drives_under_what_hangs_over_it() -> None:
    with Physics(hung(0.03), Pose2(0.0, 0.0, 0.0), RobotSpec()) as physics:
        physics.drive(Velocity(0.5, 0.0))
        for _ in range(2 * PER_SECOND):
            physics.tick()
            assert not physics.in_contact
        assert physics.world_from_robot.x_m > 0.8
        assert physics.clearance_m == CLEARANCE_LIMIT_M


@pytest.mark.parametrize("clear_m", [-0.01, -0.1])
def test_robot_meets_what_hangs_into_it(clear_m: float) -> None:
    with Physics(hung(clear_m), Pose2(0.0, 0.0, 0.0), RobotSpec()) as physics:
        physics.drive(Velocity(0.4, 0.0))
        for _ in range(2 * PER_SECOND):
            physics.tick()
        assert physics.in_contact
        assert physics.world_from_robot.x_m < 0.2  # the board begins at 0.4, the body ends 0.215 ahead


def test_clearance_is_that_of_the_nearest_of_many() -> None:
    # A ring of pillars of radius 0.1 about the robot's middle, 0.9 m away; one, ahead, at 0.7: 0.7 − 0.1 − 0.215.
    angles = [0.7 * k for k in range(1, 9)]
    places = [(0.7, 0.0), *((0.9 * math.cos(a), 0.9 * math.sin(a)) for a in angles)]
    pillars = tuple(Primitive(Shape.CYLINDER, (x, y, 0.5), (0.2, 0.2, 1.0), 0.0, (9, 9, 9)) for x, y in places)
    world = World("ring", WORLD.bounds, WORLD.floor_colour, pillars[::-1])
    with Physics(world, Pose2(0.0, 0.0, 0.0), RobotSpec()) as physics:
        assert physics.clearance_m == pytest.approx(0.385, abs=0.005)


def test_second_close_does_nothing() -> None:
    physics = Physics(WORLD, Pose2(0.0, 0.0, 0.0), RobotSpec())
    physics.close()
    physics.close()


def test_a_mat_is_floor() -> None:
    mat = Primitive(Shape.BOX, (0.5, 0.0, 0.01), (1.0, 1.0, 0.02), 0.0, (60, 60, 60))
    with Physics(World("mat", WORLD.bounds, (150, 150, 150), (mat,)), Pose2(0.0, 0.0, 0.0), RobotSpec()) as physics:
        assert physics.clearance_m == CLEARANCE_LIMIT_M
        speed_up(physics)
        assert not physics.in_contact
        assert physics.world_from_robot.x_m > 1.0
