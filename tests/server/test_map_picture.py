"""The map as a picture: the camera below, x up, y to the left."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.tick.site_report import SiteReport, SiteRoute
from revnm_server.views.map_picture import map_picture

CELL_PX = 4


def report(grid: FloorGrid | None, **routes: SiteRoute) -> SiteReport:
    state = Calibrator((640, 480)).state
    return SiteReport(1, state, grid, {"rover": Pose2(2.0, 0.5, 0.0)}, routes, (), {})


def grid() -> FloorGrid:
    """3 m ahead and 2 m wide; free floor but for the cell about (2.55, -0.75) and the unseen one about (0.05, 0.95)."""
    obstacle = np.full((20, 30), 0.02, np.float32)
    obstacle[2, 25] = 1.0
    age = np.zeros((20, 30), np.float32)
    age[19, 0] = np.inf
    return FloorGrid((0.05, -0.95), 0.1, obstacle, obstacle < 0.5, age)


def at(picture: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    row, column = int((3.0 - x_m) / 0.1 * CELL_PX), int((1.0 - y_m) / 0.1 * CELL_PX)
    return picture[row, column].astype(int)


def test_free_floor_obstacles_and_what_was_not_seen_differ() -> None:
    picture = map_picture(report(grid()))
    assert picture.shape == (30 * CELL_PX, 20 * CELL_PX, 3)
    assert at(picture, 1.25, 0.45).min() > 180  # free
    red, green, _ = at(picture, 2.55, -0.75)
    assert red > 2 * green
    assert at(picture, 0.02, 0.98).max() < 60  # unseen


def test_robot_way_and_goal_are_drawn_where_they_are() -> None:
    plain = map_picture(report(grid()))
    way = np.column_stack([np.linspace(2.0, 1.0, 20), np.full(20, 0.5)])
    drawn = map_picture(report(grid(), rover=SiteRoute("", way, None, np.array([1.0, 0.5]))))
    assert (at(drawn, 1.5, 0.5) != at(plain, 1.5, 0.5)).any()  # on the way
    assert (at(drawn, 1.0, 0.5 - 0.28) != at(plain, 1.0, 0.5 - 0.28)).any()  # on the goal's ring
    assert (at(drawn, 1.25, -0.45) == at(plain, 1.25, -0.45)).all()
    assert at(plain, 2.1, 0.5)[1] > at(plain, 2.1, 0.5)[0] + 50  # the robot is green


def test_what_is_far_from_all_that_is_known_is_cut_off() -> None:
    age = np.full((80, 60), np.inf, np.float32)
    age[38:42, 18:24] = 0.0
    obstacle = np.full((80, 60), 0.02, np.float32)
    picture = map_picture(report(FloorGrid((0.0, -4.0), 0.1, obstacle, obstacle < 0.5, age)))
    # 1 m below row 38 and over the robot's row 45; from the camera's column 0 to 1 m beyond column 23.
    assert picture.shape == (34 * CELL_PX, 28 * CELL_PX, 3)


def test_without_a_map_all_is_unseen() -> None:
    assert np.median(map_picture(report(None))) < 60
