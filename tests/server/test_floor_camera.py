"""The floor camera agrees with the simulator's, and both of its ways are inverse."""

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_sim.camera import Camera

SIM = Camera(640, 480, math.radians(100.0), (1.0, -2.0, 2.6), 0.7, math.radians(31.0), math.radians(2.0))
OURS = FloorCamera((640, 480), SIM.focal_px, SIM.pitch_rad, SIM.roll_rad, 2.6)


def points(rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([rng.uniform(1.0, 8.0, 200), rng.uniform(-3.0, 3.0, 200), rng.uniform(0.0, 1.0, 200)])


def test_it_projects_as_the_simulators_camera_does():
    local = points(np.random.default_rng(0))
    world = np.column_stack([Pose2(1.0, -2.0, 0.7).apply(local[:, :2]), local[:, 2]])
    expected, depth_m = SIM.project(world)
    pixels, depth = OURS.project(local)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    np.testing.assert_allclose(depth, depth_m, atol=1e-12)


@pytest.mark.parametrize("distortion", [0.0, -0.15, 0.05])
def test_lifting_undoes_projecting(distortion):
    camera = FloorCamera((640, 480), 300.0, 0.5, -0.03, 2.2, distortion)
    local = points(np.random.default_rng(1))
    local[:, 2] = 0.14
    pixels, _ = camera.project(local)
    back, valid = camera.on_plane(pixels, 0.14)
    assert valid.all()
    np.testing.assert_allclose(back, local[:, :2], atol=1e-9)


def test_a_barrel_draws_pixels_inwards_by_the_division_model():
    straight, bent = (FloorCamera((640, 480), 320.0, 0.6, 0.0, 2.0, value) for value in (0.0, -0.2))
    pixels, _ = bent.project(np.array([[2.0, 1.0, 0.0]]))
    ideal, _ = straight.project(np.array([[2.0, 1.0, 0.0]]))
    middle = np.array([319.5, 239.5])
    radius = np.linalg.norm(pixels - middle) / 320.0
    # Fitzgibbon: ideal radius = distorted radius / (1 + λ · distorted radius²)
    assert np.linalg.norm(ideal - middle) / 320.0 == pytest.approx(radius / (1.0 - 0.2 * radius**2))


def test_no_floor_at_or_above_the_horizon():
    camera = FloorCamera((640, 480), 320.0, 0.0, 0.0, 2.0)
    _, valid = camera.on_plane(np.array([[319.5, 239.5], [319.5, 200.0], [319.5, 260.0]]))
    assert valid.tolist() == [False, False, True]


def test_parameters_survive_the_round_trip():
    camera = FloorCamera((1280, 960), 700.0, 0.6, 0.01, 3.1, -0.1)
    again = FloorCamera.from_vector(camera.vector, camera.size_px)
    assert again.vector == pytest.approx(camera.vector)
    assert again.focal_px == pytest.approx(700.0)


def test_points_are_carried_to_where_another_calibration_has_their_pixels():
    before, now = (
        FloorCamera((640, 480), 300.0, 0.5, 0.02, 2.5),
        FloorCamera((640, 480), 330.0, 0.48, -0.01, 2.6, -0.03),
    )
    points_m = np.array([[2.5, 0.4], [4.0, -1.0], [6.0, 1.5]])
    carried, valid = before.carry(points_m, now)
    assert valid.all()
    assert np.abs(carried - points_m).max() > 0.1
    standing = [np.column_stack([each, np.zeros(3)]) for each in (points_m, carried)]
    np.testing.assert_allclose(now.project(standing[1])[0], before.project(standing[0])[0], atol=1e-6)


def test_a_lens_carries_only_what_it_has_pixels_for():
    """A lens that bends in has an end; beyond it the division model has no pixel."""
    camera = FloorCamera((640, 480), 300.0, 0.5, 0.0, 2.5, 0.03)
    points_m = np.stack(np.meshgrid(np.arange(0.2, 8.0, 0.1), np.arange(-6.0, 6.0, 0.1)), axis=-1)
    carried, valid = camera.carry(points_m, camera)
    apart = np.hypot(*np.moveaxis(carried - points_m, -1, 0))
    assert apart.max() > 1.0
    assert apart[valid].max() < 0.1
    ahead = (points_m[..., 0] > 2.0) & (np.abs(points_m[..., 1]) < 1.0)
    assert valid[ahead].all()


@pytest.mark.parametrize(
    ("points_m", "pitch_rad"),
    [([[3.0, 0.0], [-3.0, 0.0]], 0.5), ([[3.0, 0.0], [20.0, 0.0]], 0.35), ([[3.0, 0.0], [9.0, 0.0]], 0.37)],
    ids=["behind the camera", "above the horizon", "much farther than before"],
)
def test_points_that_another_calibration_does_not_have_are_not_carried(points_m, pitch_rad):
    before, now = (FloorCamera((640, 480), 300.0, pitch, 0.0, 2.5) for pitch in (0.5, pitch_rad))
    np.testing.assert_array_equal(before.carry(np.array(points_m), now)[1], [True, False])
