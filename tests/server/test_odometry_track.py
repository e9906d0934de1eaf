"""Odometry at the times of pictures, and where one drive ends and the next begins."""

import math

import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry
from revnm_server.calibration.odometry_track import OdometryTrack

MS = 1_000_000


def push(track, at_ms, x_m, yaw_rad=0.0):
    track.push(Odometry(at_ms * MS, Pose2(x_m, 0.0, yaw_rad), STANDSTILL))


def test_between_two_messages_it_interpolates():
    track = OdometryTrack(0)
    push(track, 0, 1.0)
    push(track, 100, 1.1, 0.2)
    travel = track.at(50 * MS)
    assert travel.odom_from_robot.x_m == pytest.approx(1.05)
    assert travel.odom_from_robot.yaw_rad == pytest.approx(0.1)
    assert (travel.way_m, travel.turn_rad) == (pytest.approx(0.05), pytest.approx(0.1))


def test_ways_back_count_against_ways_forward_but_add_to_the_way():
    track = OdometryTrack(0)
    for at_ms, x_m in [(0, 0.0), (100, 0.1), (200, 0.05)]:
        push(track, at_ms, x_m)
    travel = track.at(200 * MS)
    assert travel.forward_m == pytest.approx(0.05)
    assert travel.way_m == pytest.approx(0.15)


def test_a_jump_in_place_time_or_heading_begins_a_new_drive():
    track = OdometryTrack(7)
    push(track, 0, 0.0)
    push(track, 50, 0.02)
    assert track.drive == 7
    push(track, 100, 1.0)  # 1 m in 50 ms
    assert track.drive == 8
    push(track, 50, 1.0)  # back in time
    assert track.drive == 9
    push(track, 100, 1.0, math.pi)
    assert track.drive == 10
    assert track.at(100 * MS).way_m == 0.0


def test_a_robot_that_stood_while_it_was_silent_goes_on_with_its_drive():
    track = OdometryTrack(0)
    push(track, 0, 0.0)
    push(track, 5_000, 0.0)
    assert track.drive == 0
    push(track, 10_000, 0.5)  # it moved unseen
    assert track.drive == 1


def test_nothing_is_claimed_far_from_the_last_message():
    track = OdometryTrack(0)
    assert track.at(0) is None
    push(track, 1_000, 0.0)
    assert track.at(1_400 * MS) is not None
    assert track.at(1_600 * MS) is None
    assert track.at(900 * MS) is None
