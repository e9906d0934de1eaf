"""A picture is searched piece by piece: every tag lies in a piece that shows it large enough, and none is much work."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray

from revnm_server.tag.library import Region
from revnm_server.tag.regions import IDLE_WORK_PX, WORK_PX, Look, Sweep, looks, region_around

SIZES = [(320, 240), (640, 480), (1280, 960), (1920, 1080), (3840, 2160)]
LARGEST_OF = {"half": 15, "full": 30, "enlarged": 24}  # sides of tags that the looks before find, "half": times shrunk


def gray_of(size_px: tuple[int, int]) -> NDArray[np.uint8]:
    return np.zeros(size_px[::-1], np.uint8)


def work_px(region: Region) -> float:
    return region.gray.size / region.decimation**2


def largest_px(look: Look, ways: tuple[Look, ...]) -> float:
    return LARGEST_OF[look.name] * (ways[0].decimation if look.name == "half" else 1.0)


@pytest.mark.parametrize("size_px", SIZES)
@pytest.mark.parametrize("budget_px", [WORK_PX, IDLE_WORK_PX])
def test_a_tag_that_the_coarser_looks_miss_lies_in_a_piece(size_px: tuple[int, int], budget_px: int) -> None:
    ways, gray, rng = looks(size_px, budget_px), gray_of(size_px), np.random.default_rng(0)
    assert (ways[0].name, ways[0].pieces(size_px)) == ("whole", (1, 1))
    for look in ways[1:]:
        half = 0.5 * 1.25 * math.sqrt(2.0) * largest_px(look, ways)
        pieces = [look.piece(gray, number) for number in range(math.prod(look.pieces(size_px)))]
        boxes = [
            (
                each.left,
                each.top,
                each.left + each.gray.shape[1] / each.scale,
                each.top + each.gray.shape[0] / each.scale,
            )
            for each in pieces
        ]
        for x, y in rng.uniform(half, np.array(size_px) - half, (200, 2)):
            inside = [
                left <= x - half and top <= y - half and x + half <= right and y + half <= bottom
                for left, top, right, bottom in boxes
            ]
            assert any(inside)


@pytest.mark.parametrize("size_px", SIZES)
def test_no_piece_is_much_more_work_than_asked_for(size_px: tuple[int, int]) -> None:
    sweep, gray = Sweep(), gray_of(size_px)
    assert max(work_px(sweep.piece(gray, WORK_PX)) for _ in range(200)) <= 1.02 * WORK_PX


def test_the_ways_take_turns_and_each_goes_through_its_pieces() -> None:
    size_px = (1920, 1080)
    sweep, gray, ways = Sweep(), gray_of(size_px), looks(size_px, WORK_PX)
    assert [look.name for look in ways] == ["whole", "half", "full", "enlarged"]
    count = math.prod(ways[-1].pieces(size_px))
    seen = [sweep.piece(gray, WORK_PX) for _ in range(4 * count)]
    enlarged = Counter((each.left, each.top) for each in seen[3::4])
    assert len(enlarged) == count
    assert set(enlarged.values()) == {1}


@pytest.mark.parametrize(
    ("side_px", "scale", "decimation"), [(12, 3, 1), (20, 2, 1), (30, 1, 1), (40, 1, 2), (60, 1, 3), (300, 1, 4)]
)
def test_a_tag_is_looked_for_at_a_size_that_suffices(side_px: int, scale: int, decimation: int) -> None:
    corners = 500.0 + side_px * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    region = region_around(gray_of((2000, 2000)), corners, margin_sides=0.5)
    assert (region.scale, region.decimation) == (scale, decimation)
    assert region.gray.shape[0] >= 2 * side_px * scale


@pytest.mark.parametrize(
    ("size_px", "idle", "busy"), [((640, 480), 12, 36), ((1280, 960), 36, 192), ((1920, 1080), 72, 336)]
)
def test_how_many_pictures_it_takes_to_look_at_all_is_as_the_guide_says(
    size_px: tuple[int, int], idle: int, busy: int
) -> None:
    for budget_px, expected in ((IDLE_WORK_PX, idle), (WORK_PX, busy)):
        ways = looks(size_px, budget_px)
        assert len(ways) * max(math.prod(look.pieces(size_px)) for look in ways) == expected
