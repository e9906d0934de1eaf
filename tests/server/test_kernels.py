"""The compiled loops against what numpy and OpenCV make of the same numbers."""

import cv2
import numpy as np
import pytest

from revnm_server.cost_kernels import open_window, squares
from revnm_server.draw_kernels import spread_along
from revnm_server.lift_kernels import slopes, votes

RNG = np.random.default_rng(7)


def steps_of(nearness: np.ndarray, least: float, run: tuple[int, int]) -> np.ndarray:
    """Return where steps along the rows are steep the same way, and in no run of three even ones."""
    step = np.diff(nearness, axis=1)
    before, after = step[:, :-1], step[:, 1:]
    steep = (np.minimum(np.abs(before), np.abs(after)) > least) & (before * after > 0.0)
    even = np.abs(after - before) < np.float32(0.25) * np.maximum(np.abs(after), np.abs(before))
    opened = cv2.morphologyEx(even.view(np.uint8), cv2.MORPH_OPEN, np.ones(run, dtype=np.uint8))
    return np.pad(steep & ~opened.view(np.bool_), ((0, 0), (1, 1)))


@pytest.mark.parametrize("jagged", [0.0, 0.3, 3.0])
def test_slopes_are_steep_the_same_way_and_in_no_even_run(jagged: float) -> None:
    ramps = np.cumsum(RNG.choice([0.0, 1.0, -1.0, 2.0], p=[0.4, 0.3, 0.1, 0.2], size=(60, 80)), axis=1)
    picture = (ramps + np.cumsum(RNG.choice([0.0, 1.5], size=(60, 80)), axis=0)).astype(np.float32)
    picture += jagged * RNG.random(picture.shape).astype(np.float32)
    across, down = steps_of(picture, 0.5, (1, 3)), steps_of(picture.T.copy(), 0.8, (1, 3)).T
    np.testing.assert_array_equal(slopes(picture, np.float32(0.5), np.float32(0.8)), across | down)
    assert across.any()
    assert down.any()
    assert not (across | down).all()


def test_a_line_has_the_votes_of_what_lies_on_it_less_what_lies_below() -> None:
    lines = RNG.normal(size=(20, 2)).astype(np.float32)
    nearness, disparity = (4.0 * RNG.normal(size=(2, 500))).astype(np.float32)
    rest = disparity - lines[:, :1] * nearness - lines[:, 1:]
    expected = (np.abs(rest) < 2.0).sum(axis=1) - (rest < -2.5).sum(axis=1)
    np.testing.assert_array_equal(votes(lines, nearness, disparity), expected)


@pytest.mark.parametrize("axis", [0, 1])
def test_each_cell_takes_the_most_that_a_neighbour_gives(axis: int) -> None:
    probability = np.where(RNG.random((12, 9)) < 0.3, RNG.random((12, 9)), 0.0).astype(np.float32)
    weights = np.sort(RNG.random((3, 12, 9)).astype(np.float32), axis=0)[::-1].copy()
    weights[2] *= RNG.random((12, 9)) < 0.5
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


@pytest.mark.parametrize("share", [0.0, 0.003, 0.3])
@pytest.mark.parametrize("shape", [(31, 44), (3, 50), (50, 2)])
def test_distances_are_those_to_the_nearest_cell_up_to_the_reach(shape: tuple[int, int], share: float) -> None:
    stands = RNG.random(shape) < share
    exact = np.full(shape, np.inf)
    for cell in np.argwhere(stands):
        exact = np.minimum(exact, np.square(np.indices(shape) - cell[:, None, None]).sum(axis=0))
    np.testing.assert_array_equal(squares(stands, 6), np.where(exact <= 36, exact, 37))


@pytest.mark.parametrize("likely", [0.0, 25.0, np.inf])
def test_a_search_looks_at_the_open_cells_of_an_ellipse_in_whole_steps(likely: float) -> None:
    shape, start, entry = (45, 64), (11, 13), (22, 30)
    per_m, closed = RNG.random(shape).astype(np.float32), RNG.random(shape) < 0.4
    closed[:, 50:] = True
    rows, columns = np.indices(shape)
    apart = sum(np.hypot(rows - row, columns - column) for row, column in (start, entry))
    expected = np.where(closed | (apart > likely), np.inf, per_m)
    weights, top, left = open_window(per_m, closed, start, entry, likely, 10)
    assert (top % 10, left % 10) == (0, 0)
    outside = expected.copy()
    outside[top : top + weights.shape[0], left : left + weights.shape[1]] = np.inf
    assert np.isinf(outside).all()
    np.testing.assert_array_equal(weights, expected[top : top + weights.shape[0], left : left + weights.shape[1]])
    held = [*np.argwhere(np.isfinite(expected)).tolist(), start, entry]
    for axis, first in enumerate((top, left)):
        cells = [cell[axis] for cell in held]
        assert first == min(cells) // 10 * 10
        assert first + weights.shape[axis] == min(shape[axis], (max(cells) // 10 + 1) * 10)
