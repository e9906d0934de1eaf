"""What killed a process, slowed it down or gave a robot a wrong place, elsewhere or once."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from revnm_server.frame import Frame
from revnm_server.tag import TagDetector, TagLibrary, open_tag_library
from revnm_server.tag.choice import LIBRARIES, LibraryName
from revnm_server.tag.family import TAGS
from revnm_server.tag.library import Region, whole_picture
from revnm_server.tag.regions import WORK_PX, looks, region_around

from .tag_libraries import CYCLE, detector_with, first_sighting
from .tag_scene import draw_tag, floor, frame_of, picture_from_tag, project

ROVER = 3
CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
SMALL = (320, 240)
PLAIN = np.full((240, 320), 128, np.uint8)
EVERY_TAG = {tag_id: f"robot{tag_id}" for tag_id in range(TAGS)}

pytestmark = pytest.mark.parametrize("name", LIBRARIES)


@pytest.mark.parametrize("hw", [(0, 0), (0, 640), (640, 0), (1, 1), (31, 640), (480, 31), (32, 32), (33, 47)])
def test_odd_pictures_do_not_kill_the_process(name: LibraryName, hw: tuple[int, int]) -> None:
    detector = detector_with(name, {ROVER: "rover"})
    homography = picture_from_tag(centre=(290, 210), side_px=40, turn_rad=0.0)
    # Leaves a last place that lies outside the odd picture.
    first_sighting(detector, frame_of(draw_tag(floor(size=SMALL), ROVER, homography)))
    for _ in range(CYCLE):
        assert detector.sightings(Frame(np.zeros((*hw, 3), np.uint8), 1, 1)) == []


@pytest.mark.parametrize("hw", [(0, 0), (0, 64), (64, 0), (31, 640), (1, 32)])
def test_a_library_refuses_parts_that_its_code_dies_of(name: LibraryName, hw: tuple[int, int]) -> None:
    library: TagLibrary = open_tag_library(name).library
    assert library.detect(whole_picture(np.zeros(hw, np.uint8), decimation=1.0)) == []


def test_a_last_place_beyond_the_picture_leaves_an_empty_part(name: LibraryName) -> None:
    gray = np.zeros((240, 320), np.uint8)
    outside = np.array([[900.0, 900.0], [920.0, 900.0], [920.0, 920.0], [900.0, 920.0]])
    region = region_around(gray, outside, margin_sides=1.8)
    assert region.gray.size == 0
    assert open_tag_library(name).library.detect(region) == []


def test_a_tag_is_found_where_it_is_wherever_the_pieces_are_cut(name: LibraryName) -> None:
    across, down = looks(SMALL, WORK_PX)[-1].pieces(SMALL)
    assert across * down > 1
    for k in range(14):
        middle = 20 + 20 * k, 20 + 14 * k
        detector = detector_with(name, {ROVER: "rover"})
        gray = draw_tag(PLAIN, ROVER, picture_from_tag(centre=middle, side_px=20, turn_rad=0.7))
        elsewhere = {"other": CORNERS}  # somebody is expected somewhere: pieces are small
        seen = [each.pixel for _ in range(CYCLE) for each in detector.sightings(frame_of(gray), elsewhere)]
        assert seen
        np.testing.assert_allclose(seen, np.tile(middle, (len(seen), 1)), atol=0.5)


@pytest.mark.parametrize(("width_px", "side_px"), [(64, 24), (1280, 24), (160, 130)])
def test_the_size_of_the_part_does_not_decide_which_tags_are_found(
    name: LibraryName, width_px: int, side_px: int
) -> None:
    # Plain aruco has bounds on a marker's perimeter that are relative to the picture's larger side.
    library = open_tag_library(name).library
    homography = picture_from_tag(centre=(width_px / 2, 80), side_px=side_px, turn_rad=0.5 if side_px < 100 else 0.1)
    part = draw_tag(np.full((160, width_px), 128, np.uint8), ROVER, homography)
    (found,) = library.detect(whole_picture(part, decimation=1.0))
    assert found.tag_id == ROVER


def test_a_small_noisy_part_holds_no_tag(name: LibraryName) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (160, 160)).astype(np.uint8)
    assert open_tag_library(name).library.detect(Region(noise, 0, 0, 1, 1.0)) == []


def test_an_unknown_tag_and_clutter_are_no_robots(name: LibraryName) -> None:
    homography = picture_from_tag(centre=(200, 120), side_px=60, turn_rad=0.0)
    detector = detector_with(name, {ROVER: "rover"})
    frame = frame_of(draw_tag(floor(size=SMALL), 11, homography))
    assert [detector.sightings(frame) for _ in range(3)] == [[], [], []]
    detector = detector_with(name, EVERY_TAG)
    for seed in range(CYCLE):
        assert detector.sightings(frame_of(floor(seed, size=SMALL))) == []


def test_a_tag_is_never_taken_for_another(name: LibraryName) -> None:
    detector = detector_with(name, EVERY_TAG)
    rng = np.random.default_rng(1)
    for tag_id in rng.choice(TAGS, 6, replace=False).tolist():
        homography = picture_from_tag(centre=(160, 120), side_px=15, turn_rad=rng.uniform(0, 6.28), tilt=0.3)
        noisy = draw_tag(floor(tag_id, size=SMALL), tag_id, homography) + rng.normal(0.0, 12.0, (240, 320))
        frame = frame_of(np.clip(noisy, 0, 255).astype(np.uint8))
        seen = [sighting.robot for _ in range(3) for sighting in detector.sightings(frame)]
        assert set(seen) <= {f"robot{tag_id}"}


@pytest.mark.parametrize("damage_px", [12, 30])
def test_a_damaged_or_faint_tag_is_no_robot(name: LibraryName, damage_px: int) -> None:
    homography = picture_from_tag(centre=(160, 120), side_px=64, turn_rad=0.0)
    damaged = draw_tag(PLAIN, ROVER, homography)
    part = (slice(120 - damage_px // 2, 120 + damage_px // 2), slice(160 - damage_px // 2, 160 + damage_px // 2))
    damaged[part] = 255 - damaged[part]
    faint = draw_tag(PLAIN, ROVER, homography, ink=118, paper=138)
    for gray in (damaged, faint):
        detector = detector_with(name, {ROVER: "rover"})
        assert [detector.sightings(frame_of(gray)) for _ in range(3)] == [[], [], []]


@pytest.mark.parametrize("wrong_cells", [1, 2, 3])
def test_so_many_wrong_cells_are_corrected_and_no_more(name: LibraryName, wrong_cells: int) -> None:
    # The AprilTag library reads small tags well enough to need no correction; OpenCV does not.
    damaged = draw_tag(PLAIN, ROVER, picture_from_tag(centre=(159.5, 119.5), side_px=64, turn_rad=0.0))
    for column in range(wrong_cells):  # cells of 8 px, from the middle to the right
        cell = (slice(120, 128), slice(160 + 8 * column, 168 + 8 * column))
        damaged[cell] = 255 - damaged[cell]
    found = open_tag_library(name).library.detect(whole_picture(damaged, decimation=1.0))
    assert len(found) == (wrong_cells <= {"apriltag": 0, "opencv": 2}[name])


def test_detectors_of_several_cameras_work_side_by_side_and_one_after_the_other(name: LibraryName) -> None:
    # Each in a thread of its own, and each dropped while others work: detectors crashed when destroyed.
    homography = picture_from_tag(centre=(160, 120), side_px=30, turn_rad=0.0)
    frame = frame_of(draw_tag(floor(size=SMALL), ROVER, homography))
    places: list[np.ndarray] = []

    def watch() -> None:
        for _ in range(4):
            detector: TagDetector = detector_with(name, {ROVER: "rover"})
            places.extend([first_sighting(detector, frame).pixel, detector.sightings(frame)[0].pixel])

    cameras = [threading.Thread(target=watch) for _ in range(4)]
    for camera in cameras:
        camera.start()
    for camera in cameras:
        camera.join()
    assert len(places) == 32
    np.testing.assert_allclose(places, np.tile(project(homography, np.zeros((1, 2))), (32, 1)), atol=0.5)
