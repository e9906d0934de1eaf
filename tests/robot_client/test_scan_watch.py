"""A LiDAR that repeats itself is not believed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_client.scan_watch import SEES_NOTHING, STUCK, ScanWatch

ROOM = np.linspace(1.0, 3.0, 90, dtype=np.float32)


def scan(ranges: np.ndarray, index: int = 0) -> Scan:
    return Scan(index * 100_000_000, -math.pi, math.tau / 90, 0.1, 10.0, ranges.copy())


@pytest.mark.parametrize("end", [Pose2(0.031, 0.0, 0.0), Pose2(0.0, -0.031, 0.0), Pose2(0.0, 0.0, 0.031)])
def test_the_same_ranges_while_the_robot_moves(end):
    watch = ScanWatch()
    watch.look(scan(ROOM), Pose2(0.0, 0.0, 0.0))
    watch.look(scan(ROOM, 1), Pose2(end.x_m / 2.0, end.y_m / 2.0, end.yaw_rad / 2.0))
    assert watch.trouble is None
    watch.look(scan(ROOM, 2), end)
    assert watch.trouble == STUCK
    watch.look(scan(ROOM, 3), Pose2(0.0, 0.0, 0.0))  # back where it was, and still the same
    assert watch.trouble == STUCK


def test_a_scan_that_differs_ends_it():
    watch = ScanWatch()
    for index in range(2):
        watch.look(scan(ROOM, index), Pose2(0.5 * index, 0.0, 0.0))
    assert watch.trouble == STUCK
    other = ROOM.copy()
    other[7] += 0.01
    watch.look(scan(other, 2), Pose2(0.5, 0.0, 0.0))
    assert watch.trouble is None
    watch.look(scan(other, 3), Pose2(0.52, 0.0, 0.0))  # counted from the first of these
    assert watch.trouble is None


def test_a_robot_that_stands_may_see_the_same():
    watch = ScanWatch()
    for index in range(100):
        watch.look(scan(ROOM, index), Pose2(1.0, 2.0, 3.0))
    assert watch.trouble is None


def test_the_open_looks_the_same_everywhere():
    watch = ScanWatch()
    for index in range(100):
        watch.look(scan(np.full(90, np.inf, dtype=np.float32), index), Pose2(0.1 * index, 0.0, 0.0))
    assert watch.trouble is None


def test_masked_beams_are_no_returns():
    ranges = np.full(90, np.inf, dtype=np.float32)
    ranges[:20] = 0.0
    watch = ScanWatch()
    for index in range(10):
        watch.look(scan(ranges, index), Pose2(0.1 * index, 0.0, 0.0))
    assert watch.trouble is None


def test_another_frame_is_no_movement():
    watch = ScanWatch()
    watch.look(scan(ROOM), Pose2(0.0, 0.0, 0.0))
    watch.forget()
    watch.look(scan(ROOM, 1), Pose2(5.0, 0.0, 0.0))
    assert watch.trouble is None


@pytest.mark.parametrize("covered", [0.0, 0.05])
def test_a_lidar_of_which_no_beam_sees_is_covered(covered):
    watch = ScanWatch()
    watch.look(scan(np.full(90, covered, dtype=np.float32)), Pose2(0.0, 0.0, 0.0))
    assert watch.trouble == SEES_NOTHING
    watch.look(scan(np.full(90, covered, dtype=np.float32), 1), Pose2(1.0, 0.0, 0.0))
    assert watch.trouble == SEES_NOTHING
    watch.look(scan(ROOM, 2), Pose2(1.0, 0.0, 0.0))
    assert watch.trouble is None
