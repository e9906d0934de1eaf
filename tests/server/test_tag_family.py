from __future__ import annotations

import cv2
import numpy as np
import pyapriltags
import pytest

from revnm_server.tag.family import TAGS, upright_cells

from .tag_scene import upright_tag


@pytest.fixture(scope="module")
def detector() -> pyapriltags.Detector:
    return pyapriltags.Detector(families="tag36h11", nthreads=1)


@pytest.mark.parametrize("tag_id", [0, 3, 11, 300, TAGS - 1])
def test_cells_are_those_of_the_april_tag_library_the_right_way_up(detector, tag_id: int) -> None:
    # Oracle: the AprilTag library's own table of bits, drawn as its apriltag_to_image() does.
    family = detector.tag_families["tag36h11"].contents
    rim = (family.total_width - family.width_at_border) // 2
    picture = np.zeros((family.total_width, family.total_width), np.uint8)
    picture[0], picture[-1], picture[:, 0], picture[:, -1] = 255, 255, 255, 255
    for bit in range(family.nbits):
        if family.codes[tag_id] >> (family.nbits - 1 - bit) & 1:
            picture[family.bit_y[bit] + rim, family.bit_x[bit] + rim] = 255
    np.testing.assert_array_equal(upright_tag(tag_id), picture)


def test_the_family_has_as_many_tags_as_we_think(detector) -> None:
    assert detector.tag_families["tag36h11"].contents.ncodes == TAGS
    with pytest.raises(cv2.error):
        upright_cells(TAGS)
