"""The plane of a tag: exact where its corners are exact, checked against a pinhole camera."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.frame import RobotSighting
from revnm_server.mapping.tag_plane import TagPlane

TAG_M = 0.3
HALF = TAG_M / 2.0


def pinhole(points_m: np.ndarray) -> np.ndarray:
    """A camera of focal length 400 px, 3 m over the tag's plane, 30° down, that looks along world x."""
    pitch = math.radians(30.0)
    depth = points_m[:, 0] * math.cos(pitch) + 3.0 * math.sin(pitch)
    down = 3.0 * math.cos(pitch) - points_m[:, 0] * math.sin(pitch)
    return np.stack([320.0 - 400.0 * points_m[:, 1] / depth, 240.0 + 400.0 * down / depth], axis=1)


def sighting(world_from_robot: Pose2) -> RobotSighting:
    corners = np.array([[HALF, HALF], [HALF, -HALF], [-HALF, -HALF], [-HALF, HALF]])
    places = np.concatenate([[[0.0, 0.0], [1e-4, 0.0]], corners])
    pixels = pinhole(world_from_robot.apply(places))
    step = pixels[1] - pixels[0]
    return RobotSighting("rover", 1, pixels[0], step / np.linalg.norm(step), pixels[2:])


SEEN_AT = Pose2(4.0, 0.5, 1.0)


def test_points_around_the_robot_lie_where_the_camera_sees_them() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.5], [-1.0, 2.0]])
    pixels, visible = TagPlane(sighting(SEEN_AT), tag_size_m=TAG_M).project(points)
    assert visible.all()
    np.testing.assert_allclose(pixels, pinhole(SEEN_AT.apply(points)), atol=0.05)


def test_pixels_lie_on_the_plane_where_the_camera_sees_them() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.5], [-1.0, 2.0]])
    located, valid = TagPlane(sighting(SEEN_AT), tag_size_m=TAG_M).locate(pinhole(SEEN_AT.apply(points)))
    assert valid.all()
    np.testing.assert_allclose(located, points, atol=2e-3)


def test_pixels_on_and_above_the_horizon_lie_nowhere() -> None:
    horizon = 240.0 - 400.0 * math.tan(math.radians(30.0))
    pixels = np.array([[320.0, horizon + 5.0], [320.0, horizon - 5.0], [100.0, horizon - 200.0]])
    _, valid = TagPlane(sighting(SEEN_AT), tag_size_m=TAG_M).locate(pixels)
    assert valid.tolist() == [True, False, False]
