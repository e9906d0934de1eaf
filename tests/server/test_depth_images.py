"""From a camera's picture to a network's input, and from its output to disparity, by arithmetic."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_server.networks.depth_input import DepthInput, Mode, Placement, batch, place
from revnm_server.networks.depth_output import as_image, disparity_from_depth, resized, without_border

ZERO, ONE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


def takes(mode: Mode = "fixed", size_hw: tuple[int, int] = (8, 8), **more: object) -> DepthInput:
    return DepthInput(**{"name": "image", "size_hw": size_hw, "mode": mode, "mean": ZERO, "std": ONE, **more})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("mode", "size", "multiple", "picture_hw", "expected_hw"),
    [
        ("fixed", (392, 518), 14, (480, 640), (392, 518)),
        ("shortest", (518, 518), 14, (480, 640), (518, 686)),  # 640 · 518 / 480 = 690.7 = 49.3 · 14
        ("longest", (504, 504), 14, (480, 640), (378, 504)),  # 480 · 504 / 640 = 378 = 27 · 14
        ("longest", (504, 504), 14, (1080, 1920), (280, 504)),  # 283.5 = 20.25 · 14
        ("longest", (504, 504), 14, (640, 480), (504, 378)),  # upright
        ("longest", (504, 504), 14, (10, 1920), (14, 504)),  # never none
        ("shortest", (518, 518), 14, (10, 100_000), (518, 2044)),  # never without bound: 146 · 14 ≤ 2048
        ("longest", (300, 300), 1, (480, 640), (225, 300)),
    ],
)
def test_the_size_of_the_input(
    mode: Mode, size: tuple[int, int], multiple: int, picture_hw: tuple[int, int], expected_hw: tuple[int, int]
) -> None:
    assert place(picture_hw, takes(mode, size, multiple_of=multiple)) == Placement(expected_hw, 0, 0, expected_hw)


def test_a_letterbox_keeps_the_pictures_shape_in_the_middle() -> None:
    # 480 × 640 in 616 × 1064: min(616 / 480, 1064 / 640) = 1.2833; 640 · 1.2833 = 821; (1064 − 821) / 2 = 121
    assert place((480, 640), takes("letterbox", (616, 1064))) == Placement((616, 1064), 0, 121, (616, 821))
    assert place((480, 640), takes("letterbox", (500, 320))) == Placement((500, 320), 130, 0, (240, 320))


def test_pixels_are_normalised_per_channel() -> None:
    image = np.empty((8, 8, 3), dtype=np.uint8)
    image[:] = (255, 51, 0)
    unit = takes(mean=(0.5, 0.4, 0.3), std=(0.5, 0.2, 0.1))
    # (1 − 0.5) / 0.5, (0.2 − 0.4) / 0.2, (0 − 0.3) / 0.1
    np.testing.assert_allclose(batch(image, place((8, 8), unit), unit)[0, :, 3, 5], [1.0, -1.0, -3.0], rtol=1e-6)
    byte = takes(range="byte", mean=(255.0, 50.0, 0.0), std=(1.0, 2.0, 1.0))
    np.testing.assert_allclose(batch(image, place((8, 8), byte), byte)[0, :, 3, 5], [0.0, 0.5, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("more", "shape", "dtype"),
    [
        ({}, (1, 3, 8, 8), np.float32),
        ({"views": True}, (1, 1, 3, 8, 8), np.float32),
        ({"dtype": "float16"}, (1, 3, 8, 8), np.float16),
        ({"dtype": "uint8", "range": "byte"}, (1, 3, 8, 8), np.uint8),
    ],
)
def test_rank_and_type_are_the_networks(more: dict[str, object], shape: tuple[int, ...], dtype: type) -> None:
    image = np.full((6, 6, 3), 100, dtype=np.uint8)
    made = batch(image, place((6, 6), takes(**more)), takes(**more))
    assert (made.shape, made.dtype) == (shape, dtype)
    assert made.flags.c_contiguous


def test_the_border_of_a_letterbox_is_next_to_nothing_after_imagenets_normalisation() -> None:
    imagenet = takes("letterbox", (12, 6), mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225))
    image = np.full((6, 6, 3), 255, dtype=np.uint8)
    made = batch(image, place((6, 6), imagenet), imagenet)
    assert np.abs(made[:, :, [0, 1, 2, 9, 10, 11]]).max() < 0.02
    assert made[:, :, 3:9].min() > 2.0


def test_the_border_is_cut_off_again_also_from_an_output_of_half_the_size() -> None:
    placement = Placement((500, 320), 130, 0, (240, 320))
    rows = np.repeat(np.arange(500, dtype=np.float32)[:, None], 320, axis=1)
    whole = without_border(rows, placement)
    assert (whole.shape, whole[0, 0], whole[-1, 0]) == ((240, 320), 130.0, 369.0)
    assert without_border(rows[::2, ::2], placement).shape == (120, 160)
    assert without_border(rows[::250, ::160], placement).shape == (1, 2)  # never nothing


def test_leading_axes_are_dropped_and_others_refused() -> None:
    assert as_image("x", np.zeros((1, 1, 1, 4, 5), dtype=np.float16)).dtype == np.float32
    for shape in ((2, 4, 5), (1, 3, 4, 5), (7,)):
        with pytest.raises(ContractError, match=r"x: expected one image \(1, h, w\)"):
            as_image("x", np.zeros(shape, dtype=np.float32))


def test_no_depth_is_far_and_the_rest_is_inverted() -> None:
    depth = np.array([[2.0, 4.0, 0.0], [-1.0, math.inf, math.nan]], dtype=np.float32)
    np.testing.assert_allclose(disparity_from_depth(depth), [[0.5, 0.25, 0.0], [0.0, 0.0, 0.0]])


def test_sky_is_far_whatever_its_depth() -> None:
    depth, sky = np.full((1, 2), 2.0, dtype=np.float32), np.array([[0.1, 0.9]], dtype=np.float32)
    np.testing.assert_allclose(disparity_from_depth(depth, sky), [[0.5, 0.0]])


def test_a_glitch_next_to_zero_does_not_outshine_the_picture() -> None:
    depth = np.array([[1e-5, 2.0, 2.0, 4.0]], dtype=np.float32)  # the median is 2, a hundredth of it 0.02
    np.testing.assert_allclose(disparity_from_depth(depth), [[50.0, 0.5, 0.5, 0.25]])


def test_a_picture_without_any_depth_is_an_error() -> None:
    with pytest.raises(ContractError, match="no depth anywhere"):
        disparity_from_depth(np.zeros((3, 3), dtype=np.float32))
    with pytest.raises(ContractError, match="no depth anywhere"):
        disparity_from_depth(np.ones((3, 3), dtype=np.float32), np.ones((3, 3), dtype=np.float32))


def test_a_disparity_of_another_size_keeps_its_places() -> None:
    ramp = np.tile(np.arange(8, dtype=np.float32), (8, 1))
    np.testing.assert_allclose(resized(ramp, (4, 4))[0], [0.5, 2.5, 4.5, 6.5])  # means of two columns
    assert resized(ramp, (8, 8)) is ramp
    np.testing.assert_allclose(resized(ramp, (16, 16))[0, [0, 1, 2, -1]], [0.0, 0.25, 0.75, 7.0])
