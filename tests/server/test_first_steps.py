from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.planning.first_steps import StepSettings, first_steps

SETTINGS = StepSettings()
ORIGIN = [Pose2(0.0, 0.0, 0.0)]


def line(begin: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    """What a LiDAR sees of a wall, a point each 2 cm."""
    count = round(math.dist(begin, end) / 0.02) + 1
    return np.linspace(begin, end, count)


def ring(radius_m: float) -> np.ndarray:
    angles = np.linspace(-math.pi, math.pi, 360)
    return radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def steps(scan, bearing: float, driven=ORIGIN) -> np.ndarray:
    result = first_steps(scan, bearing, driven, SETTINGS)
    assert result.reason == ""
    assert result.waypoints_m is not None
    return result.waypoints_m


def side(waypoints: np.ndarray) -> float:
    return float(np.sign(waypoints[-1, 1]))


def test_the_arc_by_hand():
    """0.5 m that turn by 0.6 rad: r = 5/6 m; the end is at (r sin 0.6, r (1 − cos 0.6)) = (0.4705, 0.1456)."""
    waypoints = steps(None, 0.2)
    assert waypoints.shape == (5, 2)
    np.testing.assert_allclose(waypoints[-1], [0.4705, 0.1456], atol=1e-4)
    np.testing.assert_allclose(waypoints[0], [5 / 6 * math.sin(0.12), 5 / 6 * (1 - math.cos(0.12))])


@pytest.mark.parametrize("scan", [None, np.empty((0, 2)), ring(3.0)])
def test_with_room_it_turns_to_the_goals_side(scan):
    assert side(steps(scan, 0.5)) == 1.0
    assert side(steps(scan, -0.5)) == -1.0
    mirrored = steps(scan, 0.5) * (1.0, -1.0)
    np.testing.assert_allclose(steps(scan, -0.5), mirrored)


def test_it_turns_the_other_way_when_that_side_is_blocked():
    wall = line((0.2, 0.45), (1.0, 0.45))
    assert side(steps(wall, 0.5)) == -1.0
    assert side(steps(wall * (1.0, -1.0), -0.5)) == 1.0


def test_it_keeps_clear_where_there_is_space():
    wall = line((-1.0, 0.5), (2.0, 0.5))
    waypoints = steps(wall, 0.5)
    assert np.hypot(*(waypoints[:, None] - wall).transpose(2, 0, 1)).min() >= 0.4


def test_before_a_wall_it_sets_out_to_the_free_side():
    ahead = line((0.4, -2.0), (0.4, 2.0))
    waypoints = steps(ahead, 0.3)
    assert abs(math.atan2(waypoints[0, 1], waypoints[0, 0])) > 0.7
    assert waypoints[:, 0].max() < 0.4 - 0.25
    blocked_left = np.concatenate([ahead, line((-2.0, 0.4), (0.4, 0.4))])
    assert steps(blocked_left, 0.3)[-1, 1] < -0.2


def test_boxed_in_it_stands_and_says_so():
    result = first_steps(ring(0.35), 0.0, ORIGIN, SETTINGS)
    assert result.waypoints_m is None
    assert result.reason == "no room for 0.3 m in any direction"


def test_too_near_to_a_wall_it_may_still_leave_it():
    beside = line((-1.0, 0.24), (1.0, 0.24))
    assert side(steps(beside, 0.5)) == -1.0


def test_what_the_laser_sees_of_the_robot_itself_is_no_obstacle():
    assert side(steps(np.array([[0.05, 0.05]]), 0.5)) == 1.0


def arc_driven(length_m: float) -> list[Pose2]:
    """On the left arc of :func:`test_the_arc_by_hand`, from its beginning."""
    turns = np.arange(0.0, length_m + 1e-9, 0.01) * 1.2
    return [Pose2(math.sin(turn) / 1.2, (1.0 - math.cos(turn)) / 1.2, turn) for turn in turns]


def test_an_arc_begun_is_finished_and_the_next_goes_the_other_way():
    """The goal is far ahead of where the robot began: half-way on the left arc it is already to the right."""
    assert side(steps(None, -0.3, arc_driven(0.25))) == 1.0
    assert side(steps(None, -0.6, arc_driven(0.51))) == -1.0


def test_driven_by_it_the_robot_turns_by_what_the_calibration_needs_and_gets_nearer_to_the_goal():
    goal = np.array([5.0, 1.0])
    pose, driven = Pose2(0.0, 0.0, 0.0), [Pose2(0.0, 0.0, 0.0)]
    for _ in range(40):  # 2 m, in pieces of 5 cm
        ahead = pose.inverse().apply(goal)
        first = steps(None, math.atan2(ahead[1], ahead[0]), driven)[0]
        heading = math.atan2(first[1], first[0])
        pose = pose @ Pose2(0.05 * math.cos(heading), 0.05 * math.sin(heading), 0.06 * np.sign(heading))
        driven.append(pose)
    yaw = np.unwrap([place.yaw_rad for place in driven])
    assert np.ptp(yaw[:11]) > 0.5  # in the first half metre
    assert np.ptp(yaw) < 1.5
    assert math.dist(pose[:2], goal) < 3.5  # of 5.1 at the beginning


def test_it_gives_up_after_a_long_drive():
    driven = [Pose2(0.1 * k, 0.0, 0.0) for k in range(42)]
    result = first_steps(None, 0.0, driven, SETTINGS)
    assert result.waypoints_m is None
    assert result.reason == "no calibration after 4.1 m of driving"


def test_without_odometry_it_begins():
    assert side(steps(None, 0.3, [])) == 1.0
