from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from revnm_client.geometry import Pose2
from revnm_server.frame import Frame
from revnm_server.tag import TagDetector
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_ids
from revnm_sim.render import CameraRenderer
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.software_renderer import Region, enlarged, region_projection, view_matrix
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

GREEN, RED, BLUE = (40, 220, 40), (220, 40, 40), (40, 40, 220)
SCREEN = Primitive(Shape.BOX, (0.6, -1.0, 0.4), (0.1, 1.0, 0.8), 0.3, GREEN)
PILLAR = Primitive(Shape.CYLINDER, (1.0, 1.6, 0.5), (0.5, 0.5, 1.0), 0.0, RED)
WALL = Primitive(Shape.BOX, (4.0, 0.0, 1.0), (0.2, 6.0, 2.0), 0.0, BLUE)
WORLD = World("test", Bounds(-4.0, -4.0, 4.0, 4.0), (150, 140, 130), (SCREEN, PILLAR, WALL))
CAMERA = Camera(640, 480, math.radians(78.0), (-3.0, -0.5, 2.6), 0.15, math.radians(32.0), 0.05)
SPEC = RobotSpec()


@pytest.fixture(scope="module")
def renderer() -> Iterator[CameraRenderer]:
    with CameraRenderer(WORLD, CAMERA, SPEC, tag_id=3) as made:
        yield made


def test_matrices_project_as_the_camera_does() -> None:
    region, supersampling = Region(100, 50, 300, 200), 3
    points = np.random.default_rng(0).uniform([0.0, -1.0, 0.0], [3.0, 1.0, 1.0], (50, 3))
    view = np.array(view_matrix(CAMERA)).reshape(4, 4).T
    projection = np.array(region_projection(CAMERA, region, supersampling)).reshape(4, 4).T
    clip = np.column_stack([points, np.ones(50)]) @ view.T @ projection.T
    device = clip[:, :3] / clip[:, 3:]
    columns = (device[:, 0] + 1.0) / 2.0 * region.width * supersampling
    rows = (1.0 - device[:, 1]) / 2.0 * region.height * supersampling - 1.0
    expected = enlarged(CAMERA.project(points)[0], region, supersampling)
    np.testing.assert_allclose(np.column_stack([columns, rows]), expected, atol=1e-6)
    assert (np.abs(device[:, 2]) <= 1.0).all()


def is_colour(picture: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Tell which pixels have a colour's hue, whatever the shading."""
    levels = picture.astype(float)
    chroma = levels / levels.sum(axis=2, keepdims=True)
    return np.abs(chroma - np.array(colour) / sum(colour)).max(axis=2) < 0.05


def test_background_agrees_with_the_ray_caster() -> None:
    with CameraRenderer(WORLD, CAMERA, SPEC, tag_id=3) as renderer:
        picture = renderer.picture(Pose2(-20.0, 0.0, 0.0))  # behind the camera
    _, ids, _ = cast_ids(primitive_arrays(WORLD.primitives), CAMERA, (480, 640))
    for index, primitive in enumerate(WORLD.primitives):
        seen, expected = is_colour(picture, primitive.colour), ids == index
        # At most the pixels on the outline differ: a band one pixel wide.
        outline = cv2.morphologyEx(expected.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
        assert expected.sum() > 1000
        assert not (seen ^ expected)[~outline].any()
        # And they differ to both sides equally: no shift by half a pixel.
        for axis in (0, 1):
            middle = [np.nonzero(mask)[axis].mean() for mask in (seen, expected)]
            assert middle[0] == pytest.approx(middle[1], abs=0.25)


def test_only_the_robots_surroundings_change(renderer: CameraRenderer) -> None:
    empty = renderer.picture(Pose2(-20.0, 0.0, 0.0))
    pose = Pose2(0.0, 0.5, 1.0)
    changed = (renderer.picture(pose) != empty).any(axis=2)
    rows, columns = np.nonzero(changed)
    middle = see_robot(CAMERA, pose, SPEC, robot="rover", stamp_ns=0).pixel
    assert changed.sum() > 500
    assert np.abs(columns - middle[0]).max() < 60
    assert np.abs(rows - middle[1]).max() < 60


def test_robot_behind_an_obstacle_is_hidden(renderer: CameraRenderer) -> None:
    empty = renderer.picture(Pose2(-20.0, 0.0, 0.0))
    changed = (renderer.picture(Pose2(1.05, -1.15, 0.3)) != empty).any(axis=2)
    assert not changed.any()


def test_half_hidden_tag_leaves_the_obstacle_untouched(renderer: CameraRenderer) -> None:
    empty = renderer.picture(Pose2(-20.0, 0.0, 0.0))
    picture = renderer.picture(Pose2(1.1, -0.65, 0.3))
    green = is_colour(empty, GREEN)
    assert (picture != empty).any()
    inside = cv2.erode(green.astype(np.uint8), np.ones((5, 5))) > 0
    np.testing.assert_array_equal(picture[inside], empty[inside])


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, 2.2, -2.0, -0.7])
def test_detector_finds_the_tag_where_it_is(renderer: CameraRenderer, yaw_rad: float) -> None:
    pose = Pose2(-0.6, 0.2, yaw_rad)
    frame = Frame(renderer.picture(pose), stamp_ns=0, seq=0)
    detector = TagDetector({3: "rover"})
    # Searches at half and at full resolution take turns: the first that sees it counts.
    found = next(filter(None, (detector.sightings(frame) for _ in range(2))))[0]
    expected = see_robot(CAMERA, pose, SPEC, robot="rover", stamp_ns=0)
    np.testing.assert_allclose(found.corners, expected.corners, atol=0.5)
    np.testing.assert_allclose(found.pixel, expected.pixel, atol=0.3)
    assert float(found.heading @ expected.heading) > math.cos(math.radians(2.0))


def test_demo_camera_keeps_the_tag_detectable_across_the_room() -> None:
    camera = Camera(1280, 960, math.radians(78.0), (-3.4, -0.5, 3.2), 0.15, math.radians(35.0))
    rng = np.random.default_rng(5)
    detector = TagDetector({3: "rover"})
    found = []
    with CameraRenderer(World("bare", WORLD.bounds, (150, 140, 130), ()), camera, SPEC, tag_id=3) as renderer:
        while len(found) < 30:
            pose = Pose2(rng.uniform(-2.0, 2.5), rng.uniform(-2.0, 2.0), rng.uniform(-3.1, 3.1))
            corners = see_robot(camera, pose, SPEC, robot="rover", stamp_ns=0).corners
            if not camera.inside(corners, np.ones(4)).all():
                continue
            encoded = cv2.imencode(".jpg", renderer.picture(pose), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
            frame = Frame(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8), 0, len(found))
            found.append(any(detector.sightings(frame) for _ in range(3)))  # one of each kind of search
    assert np.mean(found) > 0.95


def test_robot_at_the_edge_and_out_of_the_picture_is_no_error(renderer: CameraRenderer) -> None:
    for x in np.linspace(-4.5, 4.5, 10):
        for y in (-4.0, 0.0, 4.0):
            assert renderer.picture(Pose2(float(x), y, 0.4)).shape == (480, 640, 3)
