"""Robots are found and followed by their tags, with either library."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.tag import TagDetector
from revnm_server.tag.choice import LIBRARIES, LibraryName

from .tag_libraries import CYCLE, detector_with, first_sighting
from .tag_scene import blur_and_noise, draw_tag, floor, frame_of, picture_from_tag, project

ROVER, SCOUT = 3, 7
CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # front left, … with y forward
SMALL = (320, 240)
S = 1_000_000_000
PLAIN = np.full((240, 320), 128, np.uint8)

pytestmark = pytest.mark.parametrize("name", LIBRARIES)


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    return abs(math.degrees(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))))


def _assert_matches(sighting: RobotSighting, homography: FloatArray) -> None:
    middle, ahead = project(homography, np.array([[0.0, 0.0], [0.0, 1e-4]]))
    assert np.abs(sighting.pixel - middle).max() < 0.7
    assert _angle_deg(sighting.heading, ahead - middle) < 3.0
    assert np.linalg.norm(sighting.heading) == pytest.approx(1.0)
    assert np.abs(sighting.corners - project(homography, CORNERS)).max() < 0.7


@pytest.mark.parametrize("side_px", [20.0, 30.0, 60.0, 130.0])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 90.0, 200.0, 311.0])
def test_pixel_heading_and_corners(name: LibraryName, side_px: float, tilt: float, turn_deg: float) -> None:
    homography = picture_from_tag(
        centre=(160.3, 130.8), side_px=side_px / (1 - 0.35 * tilt), turn_rad=math.radians(turn_deg), tilt=tilt
    )
    frame = frame_of(blur_and_noise(draw_tag(floor(size=(320, 280)), ROVER, homography)), stamp_ns=5)
    detector = detector_with(name, {ROVER: "rover", SCOUT: "scout"})
    found = first_sighting(detector, frame)
    (again,) = detector.sightings(frame)  # around the last place
    for sighting in (found, again):
        assert (sighting.robot, sighting.stamp_ns) == ("rover", 5)
        _assert_matches(sighting, homography)


@pytest.mark.parametrize("side_px", [20.0, 40.0, 120.0])
def test_pixels_are_counted_from_their_centres(name: LibraryName, side_px: float) -> None:
    # The libraries count from the pixels' outer edges; forgetting that shifts all by half a pixel.
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(8):
        detector = detector_with(name, {ROVER: "rover"})
        homography = picture_from_tag(
            centre=tuple(rng.uniform(119, 121, 2)), side_px=side_px, turn_rad=rng.uniform(0, math.tau)
        )
        frame = frame_of(draw_tag(PLAIN, ROVER, homography))
        first_sighting(detector, frame)
        (seen,) = detector.sightings(frame)
        truth = project(homography, np.vstack([[0.0, 0.0], CORNERS]))
        errors.append(np.vstack([seen.pixel, seen.corners]) - truth)
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.1


def test_heading_is_the_way_the_middle_moves_under_perspective(name: LibraryName) -> None:
    # Under strong perspective the middle of the front edge lies elsewhere than straight ahead of the middle:
    # what counts is the derivative at the tag's middle.
    homography = picture_from_tag(centre=(160, 120), side_px=90, turn_rad=0.9, tilt=0.9)
    frame = frame_of(draw_tag(floor(1, size=SMALL), ROVER, homography))
    _assert_matches(first_sighting(detector_with(name, {ROVER: "rover"}), frame), homography)


def test_a_tag_with_its_up_upwards_faces_up(name: LibraryName) -> None:
    homography = picture_from_tag(centre=(100, 100), side_px=40, turn_rad=0.0)
    sighting = first_sighting(detector_with(name, {ROVER: "rover"}), frame_of(draw_tag(PLAIN, ROVER, homography)))
    np.testing.assert_allclose(sighting.heading, [0.0, -1.0], atol=0.02)
    np.testing.assert_allclose(sighting.corners, [[80, 80], [120, 80], [120, 120], [80, 120]], atol=0.5)


def test_a_robot_is_followed_across_the_picture(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover"})
    for k in range(25):
        homography = picture_from_tag(centre=(60 + 22 * k, 400 - 14 * k), side_px=34 - 0.4 * k, turn_rad=0.2 * k)
        frame = frame_of(blur_and_noise(draw_tag(floor(2), ROVER, homography), k), stamp_ns=k * 300_000_000)
        sightings = [first_sighting(detector, frame)] if k == 0 else detector.sightings(frame)
        (sighting,) = sightings
        _assert_matches(sighting, homography)


def test_a_robot_that_was_carried_away_is_found_again(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover"})
    here = draw_tag(floor(size=SMALL), ROVER, picture_from_tag(centre=(60, 60), side_px=40, turn_rad=0.0))
    there = picture_from_tag(centre=(260, 190), side_px=18, turn_rad=2.0)
    first_sighting(detector, frame_of(here))
    assert detector.sightings(frame_of(floor(size=SMALL))) == []
    frame = frame_of(draw_tag(floor(size=SMALL), ROVER, there))
    _assert_matches(first_sighting(detector, frame), there)


def test_a_hidden_robot_is_seen_at_once_where_it_is_expected(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover"})
    here, there = (picture_from_tag(centre=(x, 120), side_px=16, turn_rad=0.4) for x in (60, 250))
    first_sighting(detector, frame_of(draw_tag(PLAIN, ROVER, here)))
    corners = project(there, CORNERS) + np.array([6.0, -5.0])
    hidden = frame_of(PLAIN, stamp_ns=2 * S)
    assert detector.sightings(hidden, {"rover": corners}) == []
    frame = frame_of(draw_tag(PLAIN, ROVER, there), stamp_ns=3 * S)
    (seen,) = detector.sightings(frame, {"rover": corners})
    _assert_matches(seen, there)


def test_a_robot_that_is_seen_is_followed_whatever_is_expected(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover"})
    homography = picture_from_tag(centre=(80, 120), side_px=40, turn_rad=0.4)
    gray, elsewhere = draw_tag(PLAIN, ROVER, homography), np.array([[250.0, 50], [270, 50], [270, 70], [250, 70]])
    first_sighting(detector, frame_of(gray))
    for k in range(1, 4):
        (seen,) = detector.sightings(frame_of(gray, stamp_ns=k * S // 10), {"rover": elsewhere})
        _assert_matches(seen, homography)


def test_a_second_robot_is_found_while_the_first_is_followed(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover", SCOUT: "scout"})
    first = picture_from_tag(centre=(80, 90), side_px=60, turn_rad=0.3)
    second = picture_from_tag(centre=(240, 150), side_px=60, turn_rad=-2.0)
    one = draw_tag(floor(size=SMALL), ROVER, first)
    both = frame_of(draw_tag(one, SCOUT, second))
    first_sighting(detector, frame_of(one))
    for _ in range(11):  # at least two searches, of the whole picture one of them
        sightings = {sighting.robot: sighting for sighting in detector.sightings(both)}
        assert "rover" in sightings
    _assert_matches(sightings["rover"], first)
    _assert_matches(sightings["scout"], second)


def test_two_robots_that_pass_each_other_keep_their_names(name: LibraryName) -> None:
    detector = detector_with(name, {ROVER: "rover", SCOUT: "scout"})
    for k in range(-1, 9):
        places = {
            "rover": picture_from_tag(centre=(60 + 25 * max(k, 0), 80), side_px=40, turn_rad=0.0),
            "scout": picture_from_tag(centre=(260 - 25 * max(k, 0), 140), side_px=40, turn_rad=math.pi),
        }
        frame = frame_of(draw_tag(draw_tag(floor(3, size=SMALL), ROVER, places["rover"]), SCOUT, places["scout"]))
        if k < 0:
            for _ in range(CYCLE):
                detector.sightings(frame)
        sightings = {sighting.robot: sighting for sighting in detector.sightings(frame)}
        assert set(sightings) == set(places)
        for robot, homography in places.items():
            _assert_matches(sightings[robot], homography)


def test_of_two_tags_with_one_id_the_clearer_one_is_the_robot(name: LibraryName) -> None:
    clear = picture_from_tag(centre=(90, 120), side_px=50, turn_rad=0.4)
    faint = picture_from_tag(centre=(230, 120), side_px=50, turn_rad=-1.0)
    for first, second in ((clear, faint), (faint, clear)):  # whichever the library reports first
        gray = draw_tag(PLAIN, ROVER, first, **({} if first is clear else {"ink": 80.0, "paper": 180.0}))
        gray = draw_tag(gray, ROVER, second, **({} if second is clear else {"ink": 80.0, "paper": 180.0}))
        detector = detector_with(name, {ROVER: "rover"})
        _assert_matches(first_sighting(detector, frame_of(gray)), clear)
        (followed,) = detector.sightings(frame_of(gray))
        _assert_matches(followed, clear)


def test_views_of_larger_arrays_are_taken_as_they_are(name: LibraryName) -> None:
    homography = picture_from_tag(centre=(160, 120), side_px=40, turn_rad=1.0)
    big = np.zeros((480, 640, 3), np.uint8)
    big[::2, ::2] = frame_of(draw_tag(PLAIN, ROVER, homography)).image
    view = big[::2, ::2]
    assert not view.flags.c_contiguous
    _assert_matches(first_sighting(detector_with(name, {ROVER: "rover"}), Frame(view, 0, 0)), homography)


@pytest.mark.parametrize(
    "image",
    [np.zeros((100, 100), np.uint8), np.zeros((100, 100, 3), np.float32), np.zeros((100, 100, 4), np.uint8)],
)
def test_a_picture_of_another_kind_is_refused(name: LibraryName, image: NDArray[np.uint8]) -> None:
    detector: TagDetector = detector_with(name, {ROVER: "rover"})
    with pytest.raises(ContractError, match=r"expected \(H, W, 3\) uint8, got"):
        detector.sightings(Frame(image, 0, 0))
