"""The reprojected view: a box before the camera must appear where the robot would see it."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.ego_prior import ego_prior
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import FloorMapper
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, Lifted
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, ego_camera
from revnm_sim.world import Primitive, Shape, primitive_arrays
from revnm_training.preset import load_preset

SPEC = load_preset("edge").observation
CAMERA = Camera(640, 480, 1.6, (0.0, 0.0, 2.5), 0.0, 0.6)
BOX = Primitive(Shape.BOX, (4.0, 0.8, 0.4), (0.6, 0.6, 0.8), 0.0, (90, 90, 90))
ROBOT = Pose2(3.2, -1.2, 1.2)


@pytest.fixture(scope="module")
def lifted() -> tuple[Lifted, FloorGrid]:
    """The exact picture of the box, lifted with the exact calibration; the floor frame is the world's."""
    hw = (192, 256)
    exact = FloorCamera((640, 480), CAMERA.focal_px, CAMERA.pitch_rad, 0.0, 2.5)
    view = floor_view(exact, hw)
    disparity = disparity_from_depth(cast_depth(primitive_arrays((BOX,)), CAMERA, hw))
    found = FloorLifter(view).lift(disparity, np.ones(hw, dtype=np.bool_))
    assert isinstance(found, Lifted)
    return found, FloorMapper(view).draw(found, np.zeros(hw, dtype=np.float32))


def test_what_is_known_is_where_the_robot_would_see_it(lifted):
    depth, known = ego_prior(*lifted, ROBOT, SPEC)
    true = cast_depth(primitive_arrays((BOX,)), ego_camera(ROBOT, SPEC), (SPEC.ego_px, SPEC.ego_px))
    guess_m = (depth + 1.0) / 2.0 * SPEC.ego_range_m
    below = slice(SPEC.ego_px // 2 + 3, None)  # floor that is near
    seen = known.astype(bool)
    assert seen[below].mean() > 0.5
    error = np.abs(guess_m - np.minimum(true, SPEC.ego_range_m))[below][seen[below]]
    assert np.median(error) < 0.05
    standing = (true < 3.0) & (np.arange(SPEC.ego_px)[:, None] <= SPEC.ego_px // 2)
    assert (standing & seen).sum() > 5  # the camera sees the box's side that faces it, and the robot sees it, too
    assert np.median(np.abs(guess_m - true)[standing & seen]) < 0.05


def test_without_a_lifted_picture_only_floor_of_the_map_is_known(lifted):
    depth, known = ego_prior(None, lifted[1], ROBOT, SPEC)
    assert not known[: SPEC.ego_px // 2].any()
    assert known[-1].any()
    assert (depth[known == 0.0] == 1.0).all()


def test_nothing_known_is_far_and_unknown():
    shape = (20, 20)
    nothing = np.zeros(shape, dtype=np.bool_), np.full(shape, np.inf, dtype=np.float32)
    grid = FloorGrid((0.0, 0.0), 0.1, np.full(shape, 0.5, dtype=np.float32), *nothing)
    depth, known = ego_prior(None, grid, Pose2(1.0, 1.0, 0.0), SPEC)
    assert (depth == 1.0).all()
    assert not known.any()
