"""The room of ``revnm-server bench``: what the camera shows and what robots measure agree with where they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.speed.room import BOXES, CAMERA, TAG_HEIGHT_M, Room, cast
from revnm_server.speed.room_picture import RoomPainter
from revnm_server.tag import TagDetector


def test_tags_are_found_where_the_robots_are() -> None:
    room = Room(3, period_s=0.1)
    room.robots[0].pose, room.robots[1].pose = Pose2(2.2, -1.0, 0.7), Pose2(6.2, 0.9, -2.0)
    room.robots[2].pose = Pose2(5.2, 0.1, 0.0)  # behind a box
    tags = {"r0": 4, "r1": 5, "r2": 6}
    frame = RoomPainter(tags).frame(room)
    detector = TagDetector({number: robot for robot, number in tags.items()})
    seen = {each.robot: each for _ in range(16) for each in detector.sightings(frame)}
    assert set(seen) == {"r0", "r1"}
    for robot in room.robots[:2]:
        points = np.array([[*robot.pose.apply(np.array([x, 0.0])), TAG_HEIGHT_M] for x in (0.0, 0.01)])
        pixels, _ = CAMERA.project(points)
        heading = (pixels[1] - pixels[0]) / np.linalg.norm(pixels[1] - pixels[0])
        np.testing.assert_allclose(seen[robot.name].pixel, pixels[0], atol=1.0)
        assert seen[robot.name].heading @ heading > 0.999


def test_ranges_are_distances_to_edges_in_the_robots_frame() -> None:
    wall = np.array([[[3.0, -1.0], [3.0, 2.0]]])  # x = 3
    ranges = cast(Pose2(1.0, 0.0, math.pi / 2.0), wall, beams=8)  # looks along y: the wall is to its right
    # Beams at -180°, -135°, -90° (right), -45°, … : right 2 m, the two beside it 2√2 m, of which the one behind misses.
    assert ranges[2] == pytest.approx(2.0)
    assert ranges[3] == pytest.approx(2.0 * math.sqrt(2.0))
    assert np.isinf(ranges[[0, 1, 4, 5, 6, 7]]).all()


def test_robots_follow_their_plans_measure_and_get_another_goal_where_they_arrive() -> None:
    room = Room(1, period_s=0.1)
    (robot,) = room.robots
    start, goal = robot.pose, robot.goal
    assert len(robot.listen().scans) == 1
    for _ in range(10):
        room.advance({"r0": np.array([[0.4, 0.0]])})
    heard = robot.listen()
    assert (len(heard.odometry), len(heard.scans)) == (10, 10)
    assert math.dist(robot.pose[:2], start[:2]) == pytest.approx(0.5)  # a second at 0.5 m/s
    assert heard.odometry[-1].odom_from_robot.x_m == pytest.approx(0.5)
    goal_m, _ = CAMERA.on_plane(goal.normalised * CAMERA.size_px - 0.5)
    for _ in range(600):
        room.advance({"r0": robot.pose.inverse().apply(goal_m[None])})
        if robot.goal is not goal:
            break
    assert robot.goal.id != goal.id
    assert not np.allclose(robot.goal.normalised, goal.normalised)


def test_goals_and_starts_lie_in_the_picture_clear_of_boxes() -> None:
    room = Room(16, period_s=0.1)
    for robot in room.robots:
        assert (robot.goal.normalised > 0.0).all()
        assert (robot.goal.normalised < 1.0).all()
        others = [math.dist(robot.pose[:2], other.pose[:2]) for other in room.robots if other is not robot]
        assert min(others) > 0.6
        for box in BOXES:
            assert (np.abs(np.subtract(robot.pose[:2], box.centre_m)) > 0.5 * np.array(box.size_m)).any()
