from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.floor_beliefs import FloorBeliefs
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.map_window import WindowSpec

SPEC = MapSpec()
ROBOT = Pose2(6.0, 0.5, 0.3)
SECOND_NS = 1_000_000_000
SIDE = WindowSpec().side


def window(value: float) -> np.ndarray:
    return np.full((SIDE, SIDE), value, dtype=np.float32)


def at(beliefs: FloorBeliefs, x_m: float, y_m: float, *, now_ns: int = 0) -> float:
    grid = beliefs.into(SPEC.unknown(), None, now_ns)
    row, column = np.rint(grid.cells(np.array([x_m, y_m]))).astype(int)
    return float(grid.obstacle[row, column])


def test_beliefs_are_averaged_over_time():
    beliefs = FloorBeliefs(SPEC)
    beliefs.take([(window(0.8), ROBOT)], 0)
    beliefs.take([(window(0.1), ROBOT)], SECOND_NS // 5)
    share = 1.0 - math.exp(-0.2 / 0.8)
    assert at(beliefs, 6.0, 0.5) == pytest.approx(share * 0.1 + (1.0 - share) * 0.8, abs=1e-5)
    for tick in range(2, 20):
        beliefs.take([(window(0.1), ROBOT)], tick * SECOND_NS // 5)
    assert at(beliefs, 6.0, 0.5) == pytest.approx(0.1, abs=0.01)


def test_the_first_belief_about_a_place_counts_alone_and_so_does_one_after_a_long_time():
    beliefs = FloorBeliefs(SPEC)
    beliefs.take([(window(0.8), ROBOT)], 0)
    beliefs.take([(window(0.1), ROBOT @ Pose2(20.0, 0.0, 0.0))], 1)  # beside it
    assert (at(beliefs, 6.0, 0.5), at(beliefs, 25.0, 6.0)) == (pytest.approx(0.8), pytest.approx(0.1))
    beliefs.take([(window(0.3), ROBOT)], 60 * SECOND_NS)
    assert at(beliefs, 6.0, 0.5) == pytest.approx(0.3)


def test_a_clock_that_runs_backwards_is_no_matter():
    beliefs = FloorBeliefs(SPEC)
    beliefs.take([(window(0.8), ROBOT)], 60 * SECOND_NS)
    beliefs.take([(window(0.1), ROBOT)], SECOND_NS)
    assert at(beliefs, 6.0, 0.5, now_ns=SECOND_NS) == pytest.approx(0.1)


def test_robots_that_stand_side_by_side_are_believed_alike():
    beliefs, beside = FloorBeliefs(SPEC), ROBOT @ Pose2(2.0, 0.0, 0.0)
    for tick in range(20):
        beliefs.take([(window(0.1), ROBOT), (window(0.8), beside)], tick * SECOND_NS // 5)
    assert at(beliefs, *ROBOT[:2]) == pytest.approx(0.45)
    assert at(beliefs, *beside[:2]) == pytest.approx(0.45)
    assert at(beliefs, *(beside @ Pose2(4.0, 0.0, 0.0))[:2]) == pytest.approx(0.8)  # no other window lies there


def test_beliefs_move_with_the_calibration_to_where_it_has_their_pixels():
    before, now = FloorCamera((640, 480), 300.0, 0.5, 0.0, 2.5), FloorCamera((640, 480), 330.0, 0.48, 0.02, 2.6)
    beliefs, ahead = FloorBeliefs(SPEC), window(0.1)
    ahead[: SIDE // 2] = 0.8
    beliefs.take([(ahead, Pose2(4.0, 0.0, 0.0))], 0)

    def edge_m() -> float:
        return next(x for x in np.arange(2.0, 7.0, 0.01) if at(beliefs, x, 0.0) > 0.45)

    was_m = edge_m()
    assert was_m == pytest.approx(4.0, abs=0.1)
    beliefs.carry(before, now)
    expected, _ = before.carry(np.array([[was_m, 0.0]]), now)
    assert expected[0, 0] > 4.3
    assert edge_m() == pytest.approx(expected[0, 0], abs=0.1)


def test_beliefs_about_what_no_picture_can_show_are_dropped_with_the_frame():
    camera = FloorCamera((640, 480), 300.0, 0.5, 0.0, 2.5)
    beliefs = FloorBeliefs(SPEC)
    beliefs.take([(window(0.8), Pose2(0.0, 0.0, 0.0))], 0)
    assert at(beliefs, -2.0, 0.0) == pytest.approx(0.8)
    beliefs.carry(camera, camera)
    assert (at(beliefs, -2.0, 0.0), at(beliefs, 3.0, 0.0)) == (0.5, pytest.approx(0.8))


def test_without_beliefs_the_map_is_what_it_was():
    grid = SPEC.unknown()
    assert FloorBeliefs(SPEC).into(grid, None, 0) is grid
