from __future__ import annotations

import math

import cv2
import numpy as np
import pyapriltags
import pytest
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.tag import TagDetector

from .tag_scene import draw_tag, frame_of, picture_from_tag, project, upright_tag

ROVER, SCOUT = 3, 7
CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # front left, … with y forward


@pytest.fixture(scope="module")
def detector() -> TagDetector:
    return TagDetector({ROVER: "rover", SCOUT: "scout"})


def _floor(seed: int = 0, *, size: tuple[int, int] = (640, 480)) -> NDArray[np.uint8]:
    """A cluttered, noisy gray picture."""
    rng = np.random.default_rng(seed)
    gray = np.full((size[1], size[0]), 120, np.uint8)
    for _ in range(60):
        corner = rng.integers(0, size)
        opposite = corner + rng.integers(5, 80, 2)
        cv2.rectangle(gray, corner.tolist(), opposite.tolist(), int(rng.integers(0, 255)), -1)
    return np.clip(gray + rng.normal(0, 3, gray.shape), 0, 255).astype(np.uint8)


def _blur_and_noise(gray: NDArray[np.uint8], seed: int = 0) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).normal(0, 3, gray.shape)
    return np.clip(cv2.GaussianBlur(gray, (0, 0), 0.5) + noise, 0, 255).astype(np.uint8)


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    return abs(math.degrees(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))))


def _assert_matches(sighting: RobotSighting, homography: FloatArray) -> None:
    middle, ahead = project(homography, np.array([[0.0, 0.0], [0.0, 1e-4]]))
    assert np.abs(sighting.pixel - middle).max() < 0.7
    assert _angle_deg(sighting.heading, ahead - middle) < 3.0
    assert np.linalg.norm(sighting.heading) == pytest.approx(1.0)
    assert np.abs(sighting.corners - project(homography, CORNERS)).max() < 0.7


def test_opencv_prints_the_family_upside_down() -> None:
    # Oracle: the AprilTag library's own table of bits, drawn as its apriltag_to_image() does. When an upgrade
    # of OpenCV breaks this (opencv/opencv#28823), whoever draws tags with it must turn them no more.
    library = pyapriltags.Detector(families="tag36h11", nthreads=1)
    family = library.tag_families["tag36h11"].contents
    rim = (family.total_width - family.width_at_border) // 2
    picture = np.zeros((family.total_width, family.total_width), np.uint8)
    picture[0], picture[-1], picture[:, 0], picture[:, -1] = 255, 255, 255, 255
    for bit in range(family.nbits):
        if family.codes[ROVER] >> (family.nbits - 1 - bit) & 1:
            picture[family.bit_y[bit] + rim, family.bit_x[bit] + rim] = 255
    np.testing.assert_array_equal(upright_tag(ROVER), picture)


@pytest.mark.parametrize("side_px", [20.0, 30.0, 60.0, 130.0])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 90.0, 200.0, 311.0])
def test_pixel_heading_and_corners(detector: TagDetector, side_px: float, tilt: float, turn_deg: float) -> None:
    homography = picture_from_tag(
        centre=(310.3, 250.8), side_px=side_px / (1 - 0.35 * tilt), turn_rad=math.radians(turn_deg), tilt=tilt
    )
    frame = frame_of(_blur_and_noise(draw_tag(_floor(), ROVER, homography)), stamp_ns=5)
    for _ in range(3):  # by either search and around the last place
        for sighting in detector.sightings(frame):
            assert (sighting.robot, sighting.stamp_ns) == ("rover", 5)
            _assert_matches(sighting, homography)
    assert len(detector.sightings(frame)) == 1


@pytest.mark.parametrize("side_px", [20.0, 40.0, 120.0])
def test_pixels_are_counted_from_their_centres(side_px: float) -> None:
    # The library counts from the pixels' outer edges; forgetting that shifts all by half a pixel.
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(8):
        detector = TagDetector({ROVER: "rover"})
        homography = picture_from_tag(
            centre=tuple(rng.uniform(199, 201, 2)), side_px=side_px, turn_rad=rng.uniform(0, math.tau)
        )
        frame = frame_of(draw_tag(np.full((400, 400), 128, np.uint8), ROVER, homography))
        seen = [sighting for _ in range(3) for sighting in detector.sightings(frame)]
        truth = project(homography, np.vstack([[0.0, 0.0], CORNERS]))
        errors.append(np.vstack([seen[-1].pixel, seen[-1].corners]) - truth)
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.1


def test_heading_is_the_way_the_middle_moves_under_perspective(detector: TagDetector) -> None:
    # Under strong perspective the middle of the front edge lies elsewhere than straight ahead of the middle:
    # what counts is the derivative at the tag's middle.
    homography = picture_from_tag(centre=(320, 240), side_px=90, turn_rad=0.9, tilt=0.9)
    frame = frame_of(draw_tag(_floor(1), ROVER, homography))
    detector.sightings(frame)
    (sighting,) = detector.sightings(frame)
    _assert_matches(sighting, homography)


def test_a_tag_with_its_up_upwards_faces_up() -> None:
    homography = picture_from_tag(centre=(100, 100), side_px=40, turn_rad=0.0)
    (sighting,) = TagDetector({ROVER: "rover"}).sightings(
        frame_of(draw_tag(np.full((200, 200), 128, np.uint8), ROVER, homography))
    )
    np.testing.assert_allclose(sighting.heading, [0.0, -1.0], atol=0.02)
    np.testing.assert_allclose(sighting.corners, [[80, 80], [120, 80], [120, 120], [80, 120]], atol=0.5)


def test_a_robot_is_followed_across_the_picture() -> None:
    detector = TagDetector({ROVER: "rover"})
    for k in range(25):
        homography = picture_from_tag(centre=(60 + 22 * k, 400 - 14 * k), side_px=26 - 0.3 * k, turn_rad=0.2 * k)
        frame = frame_of(_blur_and_noise(draw_tag(_floor(2), ROVER, homography), k), stamp_ns=k)
        sightings = detector.sightings(frame)
        if k >= 1:
            (sighting,) = sightings
            _assert_matches(sighting, homography)


def test_a_robot_that_was_carried_away_is_found_again() -> None:
    detector = TagDetector({ROVER: "rover"})
    here = frame_of(draw_tag(_floor(), ROVER, picture_from_tag(centre=(100, 100), side_px=30, turn_rad=0.0)))
    there = picture_from_tag(centre=(560, 400), side_px=17, turn_rad=2.0)
    frame = frame_of(draw_tag(_floor(), ROVER, there))
    assert any(detector.sightings(here) for _ in range(2))
    assert detector.sightings(frame_of(_floor())) == []
    found = [sighting for _ in range(3) for sighting in detector.sightings(frame)]
    assert found
    _assert_matches(found[-1], there)


def test_a_second_robot_is_found_while_the_first_is_followed() -> None:
    detector = TagDetector({ROVER: "rover", SCOUT: "scout"})
    first = picture_from_tag(centre=(100, 120), side_px=40, turn_rad=0.3)
    second = picture_from_tag(centre=(500, 300), side_px=40, turn_rad=-2.0)
    one = draw_tag(_floor(), ROVER, first)
    both = frame_of(draw_tag(one, SCOUT, second))
    assert any(detector.sightings(frame_of(one)) for _ in range(2))
    for _ in range(6):
        sightings = {sighting.robot: sighting for sighting in detector.sightings(both)}
    _assert_matches(sightings["rover"], first)
    _assert_matches(sightings["scout"], second)


def test_an_unknown_tag_and_clutter_are_no_robots(detector: TagDetector) -> None:
    homography = picture_from_tag(centre=(200, 200), side_px=60, turn_rad=0.0)
    assert detector.sightings(frame_of(draw_tag(_floor(), 11, homography))) == []
    for seed in range(4):
        assert detector.sightings(frame_of(_floor(seed))) == []


def test_a_damaged_or_faint_tag_is_no_robot() -> None:
    homography = picture_from_tag(centre=(200, 200), side_px=64, turn_rad=0.0)
    plain = np.full((400, 400), 128, np.uint8)
    damaged = draw_tag(plain, ROVER, homography)
    damaged[196:204, 196:204] = 255 - damaged[200, 200]  # about one cell
    faint = draw_tag(plain, ROVER, homography, ink=118, paper=138)
    for gray in (damaged, faint):
        detector = TagDetector({ROVER: "rover"})
        assert [detector.sightings(frame_of(gray)) for _ in range(3)] == [[], [], []]


@pytest.mark.parametrize("hw", [(0, 0), (0, 640), (1, 1), (31, 640), (480, 31), (32, 32), (33, 47)])
def test_odd_pictures_do_not_kill_the_process(hw: tuple[int, int]) -> None:
    detector = TagDetector({ROVER: "rover"})
    homography = picture_from_tag(centre=(630, 470), side_px=40, turn_rad=0.0)
    for _ in range(2):  # leaves a last place that lies outside the odd picture
        detector.sightings(frame_of(draw_tag(_floor(size=(700, 540)), ROVER, homography)))
    odd = Frame(np.zeros((*hw, 3), np.uint8), 1, 1)
    assert detector.sightings(odd) == []


def test_views_of_larger_arrays_are_taken_as_they_are() -> None:
    homography = picture_from_tag(centre=(200, 200), side_px=40, turn_rad=1.0)
    big = np.zeros((800, 800, 3), np.uint8)
    big[::2, ::2] = frame_of(draw_tag(np.full((400, 400), 128, np.uint8), ROVER, homography)).image
    view = big[::2, ::2]
    assert not view.flags.c_contiguous
    (sighting,) = TagDetector({ROVER: "rover"}).sightings(Frame(view, 0, 0))
    _assert_matches(sighting, homography)


@pytest.mark.parametrize(
    "image",
    [np.zeros((100, 100), np.uint8), np.zeros((100, 100, 3), np.float32), np.zeros((100, 100, 4), np.uint8)],
)
def test_a_picture_of_another_kind_is_refused(detector: TagDetector, image: NDArray[np.uint8]) -> None:
    with pytest.raises(ContractError, match=r"expected \(H, W, 3\) uint8, got"):
        detector.sightings(Frame(image, 0, 0))
