from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from revnm_server.observation import (
    ImagePose,
    ObservationSpec,
    crop_around,
    crops_around,
    exo_views,
    normalise_disparity,
    normalise_ego_depth,
    normalise_pixel,
)

SPEC = ObservationSpec(
    history=1,
    history_interval_s=0.2,
    disparity_hw=(60, 80),
    exo_hw=(30, 40),
    crop_px=21,
    crop_span=21 / 80,  # a crop pixel is as large as a disparity pixel where the picture is 4:3
    crop_heading_up=True,
    ego_px=32,
    ego_hfov_rad=1.5,
    ego_height_m=0.3,
    ego_range_m=5.0,
    waypoints=5,
    spacing_m=0.3,
)
UP, DOWN, LEFT, RIGHT = (0.0, -1.0), (0.0, 1.0), (-1.0, 0.0), (1.0, 0.0)


def _pose_at(column: int, row: int, heading: tuple[float, float], *, hw: tuple[int, int] = (60, 80)) -> ImagePose:
    """Return the pose whose place is the middle of a pixel of the disparity."""
    return ImagePose(np.array([(column + 0.5) / hw[1], (row + 0.5) / hw[0]]), np.array(heading))


def _brightest(image: np.ndarray) -> tuple[int, int]:
    """Column and row of the brightest pixel."""
    row, column = np.unravel_index(int(np.argmax(image)), image.shape)
    return int(column), int(row)


@pytest.mark.parametrize(("heading", "ahead"), [(UP, (0, -7)), (DOWN, (0, 7)), (LEFT, (-7, 0)), (RIGHT, (7, 0))])
def test_what_lies_ahead_is_up_in_the_crop(heading: tuple[float, float], ahead: tuple[int, int]) -> None:
    disparity = np.zeros((60, 80), np.float32)
    disparity[30 + ahead[1], 40 + ahead[0]] = 1.0
    crop = crop_around(disparity, _pose_at(40, 30, heading), 80 / 60, SPEC)
    assert crop.shape == (21, 21)
    assert _brightest(crop) == (10, 3)  # the robot is at (10, 10); seven pixels up from it
    assert crop.max() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("heading", "right"), [(UP, (7, 0)), (DOWN, (-7, 0)), (LEFT, (0, -7)), (RIGHT, (0, 7))])
def test_what_lies_to_the_right_is_right_in_the_crop(heading: tuple[float, float], right: tuple[int, int]) -> None:
    disparity = np.zeros((60, 80), np.float32)
    disparity[30 + right[1], 40 + right[0]] = 1.0
    assert _brightest(crop_around(disparity, _pose_at(40, 30, heading), 80 / 60, SPEC)) == (17, 10)


def test_without_heading_up_the_crop_stays_upright() -> None:
    spec = dataclasses.replace(SPEC, crop_heading_up=False)
    disparity = np.random.default_rng(0).random((60, 80), dtype=np.float32)
    crop = crop_around(disparity, _pose_at(40, 30, RIGHT), 80 / 60, spec)
    np.testing.assert_allclose(crop, disparity[20:41, 30:51], atol=1e-5)


def test_outside_the_picture_is_zero() -> None:
    crop = crop_around(np.ones((60, 80), np.float32), _pose_at(0, 0, UP), 80 / 60, SPEC)
    np.testing.assert_allclose(crop[10:, 10:], 1.0, atol=1e-5)
    assert crop[:9].max() == 0.0
    assert crop[:, :9].max() == 0.0


def test_the_squeezed_aspect_is_undone() -> None:
    # A 16:9 picture squeezed into 60 × 80. A disc of radius 0.08 picture widths stays round in the crop.
    height, width = 540, 960
    picture = cv2.circle(np.zeros((height, width), np.float32), (480, 270), 77, 1.0, -1)
    disparity = cv2.resize(picture, (80, 60), interpolation=cv2.INTER_AREA)
    pose = ImagePose(np.array([0.5, 0.5]), np.array([0.6, 0.8]))
    spec = dataclasses.replace(SPEC, crop_px=64, crop_span=0.24)
    crop = crop_around(disparity, pose, width / height, spec)
    inside = crop > 0.5
    across, along = int(inside.any(axis=0).sum()), int(inside.any(axis=1).sum())
    # The radius is 77 / 960 · 64 / 0.24 = 21.4 pixels of the crop.
    assert across == pytest.approx(43, abs=2)
    assert along == pytest.approx(43, abs=2)


def test_a_history_is_cut_around_one_pose() -> None:
    disparities = np.random.default_rng(0).random((5, 60, 80), dtype=np.float32)
    pose = _pose_at(25, 35, (0.6, 0.8))
    crops = crops_around(disparities, pose, 80 / 60, SPEC)
    assert crops.shape == (5, 21, 21)
    np.testing.assert_array_equal(crops[3], crop_around(disparities[3], pose, 80 / 60, SPEC))
    views = exo_views(disparities, SPEC)
    assert views.shape == (5, 30, 40)
    # Half the size: means of two by two.
    expected = disparities[2].reshape(30, 2, 40, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(views[2], expected, atol=1e-5)


def test_disparity_is_normalised_whatever_its_scale_and_shift() -> None:
    disparity = np.random.default_rng(0).random((60, 80), dtype=np.float32)
    normal = normalise_disparity(disparity)
    assert (normal.min(), normal.max()) == (0.0, 1.0)
    np.testing.assert_allclose(normalise_disparity(7.0 * disparity + 3.0), normal, atol=1e-5)
    assert normalise_disparity(np.full((60, 80), 5.0, np.float32)).max() == 0.0


def test_a_few_extreme_values_do_not_matter() -> None:
    disparity = np.linspace(0, 1, 4800, dtype=np.float32).reshape(60, 80)
    normal = normalise_disparity(disparity)
    disparity[0, :10] = 1000.0
    np.testing.assert_allclose(normalise_disparity(disparity)[1:], normal[1:], atol=0.01)


def test_ego_depth_is_mapped_to_plus_minus_one() -> None:
    depth = np.array([[0.0, 2.5, 5.0, 99.0, np.inf]], np.float32)
    np.testing.assert_allclose(normalise_ego_depth(depth, SPEC), [[-1.0, 0.0, 1.0, 1.0, 1.0]])


def test_pixels_are_normalised_by_width_and_height() -> None:
    np.testing.assert_allclose(normalise_pixel(np.array([320.0, 120.0]), (640, 480)), [0.5, 0.25])
