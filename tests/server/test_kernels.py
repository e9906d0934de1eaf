"""The compiled loops against plain numpy, OpenCV and Python on random numbers."""

import math
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from revnm_server.mapping import draw_kernels, lift_kernels
from revnm_server.mapping.draw_kernels import (
    Cells,
    Gaps,
    Picture,
    floor_evidence,
    obstacle_evidence,
    spread_along,
    weighed,
)
from revnm_server.mapping.lift import Kind
from revnm_server.mapping.lift_kernels import Rays, placed, slopes, votes
from revnm_server.mapping.memory_kernels import Background, learnt
from revnm_server.mapping.scan_kernels import Fan, Middles, Window, fused, passed
from revnm_server.planning.search_kernels import open_window

HW = (14, 17)
CELLS = Cells(np.float32(-0.95), np.float32(-0.55), np.float32(10.0), 12, 20)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def steps_of(nearness: np.ndarray, least: float) -> np.ndarray:
    """Return where steps along the rows are steep the same way, and in no run of three even ones."""
    step = np.diff(nearness, axis=1)
    before, after = step[:, :-1], step[:, 1:]
    steep = (np.minimum(np.abs(before), np.abs(after)) > least) & (before * after > 0.0)
    even = np.abs(after - before) < np.float32(0.25) * np.maximum(np.abs(after), np.abs(before))
    opened = cv2.morphologyEx(even.view(np.uint8), cv2.MORPH_OPEN, np.ones((1, 3), dtype=np.uint8))
    return np.pad(steep & ~opened.view(np.bool_), ((0, 0), (1, 1)))


@pytest.mark.parametrize("hw", [(60, 80), (3, 3), (4, 5)])
@pytest.mark.parametrize("jagged", [0.0, 0.3, 3.0])
def test_slopes_are_steep_the_same_way_and_in_no_even_run(rng, hw: tuple[int, int], jagged: float) -> None:
    for _ in range(20):
        ramps = np.cumsum(rng.choice([0.0, 1.0, -1.0, 2.0], p=[0.4, 0.3, 0.1, 0.2], size=hw), axis=1)
        picture = (ramps + np.cumsum(rng.choice([0.0, 1.5], size=hw), axis=0)).astype(np.float32)
        picture += jagged * rng.random(hw).astype(np.float32)
        across, down = steps_of(picture, 0.5), steps_of(picture.T.copy(), 0.8).T
        np.testing.assert_array_equal(slopes(picture, np.float32(0.5), np.float32(0.8)), across | down)
    assert hw != (60, 80) or (across.any() and down.any() and not (across | down).all())


@pytest.mark.parametrize("hw", [(1, 2), (2, 1), (2, 2)])
def test_so_small_a_picture_has_no_slopes(rng, hw: tuple[int, int]) -> None:
    assert not slopes(rng.random(hw).astype(np.float32), np.float32(0.0), np.float32(0.0)).any()


def test_a_line_has_the_votes_of_what_lies_on_it_less_what_lies_below(rng) -> None:
    lines = rng.normal(size=(20, 2)).astype(np.float32)
    nearness, disparity = (4.0 * rng.normal(size=(2, 500))).astype(np.float32)
    rest = disparity - lines[:, :1] * nearness - lines[:, 1:]
    expected = (np.abs(rest) < 2.0).sum(axis=1) - (rest < -2.5).sum(axis=1)
    np.testing.assert_array_equal(votes(lines, nearness, disparity), expected)


def lifted(rng) -> Picture:
    """Return a picture of some surfaces, on and off the cells."""
    columns, rows = np.meshgrid(np.arange(HW[1]), np.arange(HW[0]))
    x = 0.11 * columns - 0.9 + 0.15 * rng.random(HW)
    y = 0.12 * rows - 0.6 + 0.31 * rng.random(HW) * (rng.random(HW) < 0.3)
    floats = (x, y, rng.random(HW), rng.random(HW), 5.0 * rng.random(HW))
    return Picture(rng.integers(0, 3, HW).astype(np.uint8), *(each.astype(np.float32) for each in floats))


@pytest.mark.parametrize("kernels", [draw_kernels, lift_kernels])
def test_kinds_of_pixels_are_those_of_the_lift(kernels) -> None:
    assert (kernels.FLOOR, kernels.OBSTACLE) == (Kind.FLOOR, Kind.OBSTACLE)


def test_what_is_lifted_stands_lies_or_is_unknown(rng) -> None:
    nearness = rng.uniform(-0.05, 0.6, HW).astype(np.float32)
    floor, tolerance, x, y = (rng.uniform(0.0, 0.5, (4, *HW))).astype(np.float32)
    usable, below = rng.random((2, *HW)) < 0.7
    rays = Rays(floor, 1.0 / np.maximum(floor, np.float32(0.01)), tolerance, below, x, y)
    camera, farthest, least, most = (np.float32(each) for each in (2.5, 0.06, 1e-3, 0.4))
    kind, at_x, at_y, height, grade = placed(nearness, usable, rays, camera, farthest, least, most)
    depth = 1.0 / np.maximum(nearness, least)
    expected = camera * (1.0 - depth * floor)
    stands = usable & (nearness > farthest) & (expected > tolerance)
    lies = usable & below & ~stands & (tolerance < most) & (expected > -2.0 * tolerance)
    assert stands.any()
    assert lies.any()
    np.testing.assert_array_equal(kind, np.where(stands, Kind.OBSTACLE, np.where(lies, Kind.FLOOR, Kind.UNKNOWN)))
    depth = np.where(lies, rays.floor_m, depth)
    np.testing.assert_allclose(height, expected, rtol=1e-6)
    np.testing.assert_allclose((at_x, at_y), (depth * x, depth * y), rtol=1e-6)
    sure = np.clip(expected / tolerance - 1.0, -1.0, 1.0) * (stands | lies)
    np.testing.assert_allclose(grade, sure, atol=1e-5)


@pytest.mark.parametrize("step_rad", [math.tau / 90.0, -math.tau / 90.0, math.radians(2.0)])
def test_beams_pass_near_the_middles_of_the_cells_before_their_ends(rng, step_rad: float) -> None:
    free, pose = rng.uniform(-0.5, 4.0, 90).astype(np.float32), (1.03, -0.4, 0.7)
    x, y = (np.arange(size) * 0.1 - 3.0 for size in (70, 60))
    fan = Fan(np.float32(1.03), np.float32(-0.4), np.float32(0.7), np.float32(step_rad), free)
    middles, window = Middles(x.astype(np.float32), y.astype(np.float32), np.float32(0.1)), Window(5, 55, 10, 66)
    found = passed(fan, middles, window)
    expected = np.zeros_like(found)
    for row, column in np.ndindex(*found.shape):
        dx, dy = x[column + 10] - pose[0], y[row + 5] - pose[1]
        off = [math.remainder(math.atan2(dy, dx) - pose[2] - beam * step_rad, math.tau) for beam in range(90)]
        beam = int(np.argmin(np.abs(off)))
        distance = math.hypot(dx, dy)
        within = abs(off[beam]) <= 0.5 * abs(step_rad) + 1e-9
        expected[row, column] = within and abs(off[beam]) * distance <= 0.05 and distance < free[beam]
    assert expected.any()
    assert (found != expected).sum() <= 3  # by rounding


def test_scans_overrule_the_camera_where_they_are_sure(rng) -> None:
    shape = (20, 30)
    obstacle, age = rng.random(shape).astype(np.float32), (5.0 * rng.random(shape)).astype(np.float32)
    floor, told = rng.random((2, *shape)) < 0.5
    logit = np.where(told, rng.normal(0.0, 2.0, shape), 0.0).astype(np.float32)
    seen_s = np.where(told, 10.0 * rng.random(shape), -math.inf)
    stands, lies, since = fused(obstacle, floor, age, logit, seen_s, np.float32(1.0), 10.0)
    clear = np.clip(obstacle, 1e-3, 1.0 - 1e-3)
    total = np.log(clear / (1.0 - clear)) + logit
    total = np.where(logit >= 1.0, np.maximum(total, logit), total)
    np.testing.assert_allclose(stands, 1.0 / (1.0 + np.exp(-total)), atol=1e-6)
    np.testing.assert_array_equal(lies, floor | (logit <= -1.0))
    np.testing.assert_allclose(since, np.minimum(age, 10.0 - seen_s), rtol=1e-6)


def test_floor_is_what_is_looked_up_or_drawn(rng) -> None:
    picture, shape = lifted(rng), (10, 12)
    cell = rng.choice([*range(0, 120, 2), 120], HW)  # 120 lies off the cells
    near, far = rng.integers(0, math.prod(HW), (2, *shape))
    in_view = rng.random(shape) < 0.7
    picture.grade[picture.kind == Kind.FLOOR] *= -1.0
    seen, total, age = floor_evidence(picture, cell, near, far, in_view)
    is_floor = picture.kind.ravel() == Kind.FLOOR
    drawn = np.array([picture.grade.ravel()[is_floor & (cell.ravel() == k)].sum() for k in range(120)])
    drawn = drawn.reshape(shape)
    looked_up = in_view & is_floor[near] & is_floor[far]
    np.testing.assert_array_equal(seen, looked_up | (drawn < 0.0))
    alone = np.where(looked_up, picture.grade.ravel()[near], 0.0)
    np.testing.assert_allclose(total, np.where(drawn < 0.0, drawn, alone), rtol=1e-5)
    np.testing.assert_array_equal(age, np.where(seen, picture.age_s.ravel()[near], np.inf))
    assert (looked_up & (drawn == 0.0)).any()
    assert (~looked_up & (drawn < 0.0)).any()


def test_obstacles_and_what_lies_between_neighbours_are_thrown_into_cells(rng) -> None:
    picture = lifted(rng)
    gaps = Gaps(np.full(HW, 0.8, np.float32), np.float32(0.5), np.full(HW, 0.7, np.float32), np.float32(0.4))
    piece_m, logit, overhead_m = 0.07, 1.2, 0.5
    layers = np.zeros((4, CELLS.rows, CELLS.columns))
    counts = set()

    def throw(first, second, share: float) -> None:
        x, y, height, grade = ((1 - share) * each[first] + share * each[second] for each in picture[1:5])
        column, row = round(float((x - CELLS.x_m) * 10.0)), round(float((y - CELLS.y_m) * 10.0))
        if 0 <= column < CELLS.columns and 0 <= row < CELLS.rows:
            layers[int(height > overhead_m), row, column] += logit * grade
            layers[2:, row, column] += 1.0, picture.age_s[first]

    obstacles = set(map(tuple, np.argwhere(picture.kind == Kind.OBSTACLE).tolist()))
    for first in obstacles:
        throw(first, first, 0.0)
        for step in ((0, 1), (1, 0)):
            second = first[0] + step[0], first[1] + step[1]
            x, y = (abs(float(each[first])) for each in picture[1:3])
            gap = 0.5 * max(x, y) / 0.8 if step == (0, 1) else 0.4 * (x + y) / 0.7
            if second in obstacles:
                apart = max(abs(float(each[second] - each[first])) for each in picture[1:3])
                if piece_m < apart < gap:
                    counts.add(pieces := min(max(math.ceil(apart / piece_m), 2), 8))
                    for piece in range(1, pieces):
                        throw(first, second, piece / pieces)
    np.testing.assert_allclose(obstacle_evidence(CELLS, picture, gaps, piece_m, logit, overhead_m), layers, rtol=1e-5)
    assert len(counts) > 2
    assert layers[:2].all(axis=(1, 2)).sum() == 0
    assert (layers[0] > 0.0).any()
    assert (layers[1] > 0.0).any()


def test_evidence_is_weighed_within_its_bounds(rng) -> None:
    shape = (12, 20)
    seen, graded = rng.random(shape) < 0.5, rng.normal(size=shape) * 9.0
    layers = rng.random((4, *shape)) * 6.0 - 1.0
    layers[2] = rng.integers(0, 3, shape)
    ages = rng.random(shape).astype(np.float32)
    logit, age = weighed(seen, graded, ages, layers, 0.4, 0.85, 4.0)
    total = 0.4 * graded + layers[0] + np.where(seen, 0.0, np.minimum(layers[1], 0.85))
    np.testing.assert_allclose(logit, np.clip(total, -4.0, 4.0), rtol=1e-6)
    np.testing.assert_allclose(age, np.where(layers[2] > 0, layers[3] / np.maximum(layers[2], 1), ages), rtol=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_each_cell_takes_the_most_that_a_neighbour_gives(rng, axis: int) -> None:
    probability = np.where(rng.random((12, 9)) < 0.3, rng.random((12, 9)), 0.0).astype(np.float32)
    weights = np.sort(rng.random((3, 12, 9)).astype(np.float32), axis=0)[::-1].copy()
    weights[2] *= rng.random((12, 9)) < 0.5
    expected = probability.copy()
    for row, column in np.ndindex(probability.shape):
        for distance in (1, 2, 3):
            for sign in (1, -1):
                to = [row, column]
                to[axis] += sign * distance
                if 0 <= to[axis] < probability.shape[axis]:
                    given = probability[row, column] * weights[distance - 1, row, column]
                    expected[tuple(to)] = max(expected[tuple(to)], given)
    np.testing.assert_array_equal(spread_along(probability, weights, axis == 0), expected)


def test_the_background_is_learnt_as_by_whole_arrays(rng) -> None:
    """Pixels that agree, pixels that change all the time, and pixels that change once and then stay."""
    zeros, never = np.zeros(HW, np.float32), np.full(HW, np.inf)
    memory = Background(zeros.copy(), zeros.copy(), zeros.copy(), never.copy(), -never, np.zeros(HW, dtype=np.bool_))
    background, count, candidate, since = zeros.copy(), zeros.copy(), zeros.copy(), never.copy()
    last_seen, was_cut, settled_once = -never, np.zeros(HW, dtype=np.bool_), np.zeros(HW, dtype=np.bool_)
    restless, moved, tolerance = rng.random(HW) < 0.3, rng.random(HW) < 0.3, np.float32(0.1)
    for tick in range(12):
        stamp, seen, cut = 0.2 * tick, rng.random(HW) < 0.8, rng.random(HW) < 0.1
        picture = 0.02 * rng.normal(size=HW) + 3.0 * (moved & (tick >= 4)) + restless * 5.0 * rng.random(HW)
        picture = picture.astype(np.float32)
        new = seen & (count == 0.0)
        difference = picture - background
        agree = seen & ~new & (np.abs(difference) < tolerance)
        differs = seen & ~new & ~agree
        background += agree * np.maximum(np.float32(1.0) / (count + 1.0), np.float32(0.3)) * difference
        count += agree
        same = differs & np.isfinite(since) & (np.abs(picture - candidate) < tolerance)
        candidate = np.where(same, candidate + np.float32(0.3) * (picture - candidate), candidate)
        candidate, since = np.where(differs & ~same, picture, candidate), np.where(differs & ~same, stamp, since)
        settled = differs & (stamp - since >= 0.6)
        background, count = np.where(new | settled, picture, background), np.where(new | settled, 1.0, count)
        count = count.astype(np.float32)
        since = np.where(agree | settled, np.inf, since)
        last_seen, was_cut = np.where(seen, stamp, last_seen), np.where(seen, cut, was_cut)
        settled_once |= settled
        moving = differs & ~settled
        shown = learnt(memory, picture, seen, cut, tolerance, np.float32(0.3), 0.6, stamp)
        expected = np.where(moving, picture, background), (count > 0.0) & ~was_cut, stamp - last_seen, moving
        for found, each in zip(shown, expected, strict=True):
            np.testing.assert_array_equal(found, each.astype(found.dtype))
    assert settled_once[moved & ~restless].mean() > 0.9
    assert settled_once[restless].mean() < 0.1
    assert moving[restless].any()


@pytest.mark.parametrize("likely", [0.0, 25.0, np.inf])
@pytest.mark.parametrize("start", [(11, 13), (0, 0), (44, 55)])
def test_a_search_looks_at_the_open_cells_of_an_ellipse_in_whole_steps(rng, start, likely: float) -> None:
    shape, entry = (45, 64), (22, 30)
    per_m, closed = rng.random(shape).astype(np.float32), rng.random(shape) < 0.4
    closed[:, 50:] = True
    closed[entry] = True
    rows, columns = np.indices(shape)
    apart = sum(np.hypot(rows - row, columns - column) for row, column in (start, entry))
    expected = np.where(closed | (apart > likely), np.inf, per_m)
    weights, top, left = open_window(per_m, closed, start, entry, likely, 10)
    window = slice(top, top + weights.shape[0]), slice(left, left + weights.shape[1])
    np.testing.assert_array_equal(weights, expected[window])
    held = [*np.argwhere(np.isfinite(expected)).tolist(), start, entry]
    for axis, each in enumerate(window):
        cells = [cell[axis] for cell in held]
        assert each.start == min(cells) // 10 * 10
        assert each.stop == min(shape[axis], (max(cells) // 10 + 1) * 10)


def test_without_a_folder_for_its_cache_it_compiles_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "loops.py").write_text(
        "import logging\nlogging.basicConfig()\n"
        "from numba import int64\nfrom revnm_server.compiled import compiled\n"
        "@compiled(int64, int64)\ndef twice(n):\n    return 2 * n\n"
        "@compiled(int64, int64)\ndef thrice(n):\n    return 3 * n\n"
        "print(twice(3), thrice(3))\n"
    )
    nowhere = {"NUMBA_CACHE_DIR": str(tmp_path / "file"), "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    ran = subprocess.run(
        [sys.executable, str(tmp_path / "loops.py")], env=os.environ | nowhere, capture_output=True, text=True
    )
    assert ran.stdout == "6 9\n", ran.stderr
    assert ran.stderr.count("NUMBA_CACHE_DIR") == 1
