"""Pictures for training: deterministic by the generator, varied, and true to the geometry."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import Pose2
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_ids, ray_grid, robot_primitive
from revnm_sim.robot import RobotSpec
from revnm_sim.shade import shade
from revnm_sim.shade_kernels import CHECKER, PLAIN, Seen, Surfaces, shade_cells
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

CAMERA = Camera(640, 480, math.radians(90.0), (0.5, 4.0, 2.5), 0.0, math.radians(30.0))


def small_world() -> World:
    wall = Primitive(Shape.BOX, (8.0, 4.0, 1.5), (0.2, 8.0, 3.0), 0.0, (180, 170, 160))
    box = Primitive(Shape.BOX, (4.0, 3.0, 0.5), (0.8, 0.8, 1.0), 0.5, (200, 40, 40))
    pillar = Primitive(Shape.CYLINDER, (4.0, 5.0, 0.6), (0.6, 0.6, 1.2), 0.0, (40, 60, 200))
    return World("small", Bounds(0.0, 0.0, 8.0, 8.0), (120, 120, 120), (wall, box, pillar))


def picture(seed: int, **options: tuple[Primitive, ...]) -> NDArray[np.uint8]:
    return shade(small_world(), CAMERA, (96, 72), np.random.default_rng(seed), **options)


def test_shape_and_type() -> None:
    image = shade(small_world(), CAMERA, (96, 72), np.random.default_rng(0))
    assert image.shape == (72, 96, 3)
    assert image.dtype == np.uint8


def test_same_generator_state_gives_the_same_picture() -> None:
    np.testing.assert_array_equal(picture(4), picture(4))


def test_pictures_vary_and_are_well_exposed() -> None:
    images = np.stack([picture(seed) for seed in range(20)]).astype(np.float64)
    means = images.mean(axis=(1, 2, 3))
    assert means.min() > 60.0
    assert means.max() < 235.0
    assert images.std(axis=0).mean() > 20.0  # the same cell differs from picture to picture
    assert (images.std(axis=(1, 2, 3)) > 10.0).all()  # no picture is flat


def test_edges_of_things_show() -> None:
    # Averaged over many random pictures, colour steps are larger across the edges of things than elsewhere.
    _, ids, _ = cast_ids(primitive_arrays(small_world().primitives), CAMERA, (72, 96))
    edge = ids[:, 1:] != ids[:, :-1]
    steps = np.mean(
        [np.abs(np.diff(picture(seed).astype(np.float64), axis=1)).mean(axis=-1) for seed in range(30)], axis=0
    )
    assert steps[edge].mean() > 3.0 * steps[~edge].mean()


def test_extra_primitives_are_in_the_picture() -> None:
    robot = robot_primitive(Pose2(3.0, 4.0, 0.0), RobotSpec())
    _, ids, _ = cast_ids(primitive_arrays((*small_world().primitives, robot)), CAMERA, (72, 96))
    on_robot = ids == 3
    assert on_robot.any()
    contrasts = []
    for seed in range(20):
        image = picture(seed, extra=(robot,)).astype(np.float64)
        contrasts.append(np.abs(image[on_robot].mean(axis=0) - image[ids == -1].mean(axis=0)).mean())
    assert np.mean(contrasts) > 10.0


def surfaces_of(kind: int, *, scale_m: float) -> Surfaces:
    """A bare floor with black and white as its colours."""
    return Surfaces(
        centre_m=np.zeros((1, 3)),
        axis=np.array([[1.0, 0.0]]),
        radius_m=np.zeros(1),
        kind=np.array([kind]),
        scale_m=np.array([scale_m]),
        turn=np.array([[1.0, 0.0]]),
        colours=np.array([[[0.0] * 3, [1.0] * 3]]),
    )


def floor_from_above(kind: int) -> NDArray[np.float32]:
    """A floor of 8 × 8 cells of 0.25 m seen from 1 m straight above, in ambient light alone."""
    camera = Camera(8, 8, math.radians(90.0), (0.0, 0.0, 1.0), 0.0, math.radians(90.0))
    seen = Seen(*cast_ids(primitive_arrays(()), camera, (8, 8)), ray_grid(camera, (8, 8)))
    surfaces = surfaces_of(kind, scale_m=1.0)
    lamp = np.array([[0.0, 0.0, 5.0, 0.0, 1.0]])
    light: NDArray[np.float32] = shade_cells(seen, surfaces, lamp, 1.0, np.zeros((2, 3)))
    return light[..., 0]


def test_checker_has_squares_of_its_scale() -> None:
    # 8 × 8 cells cover [-1, 1]²; squares of 1 m: the two halves of each axis alternate. Cells of a quarter of a
    # square fade a little.
    half = np.repeat([False, True], 4)
    white = floor_from_above(CHECKER) > 0.5
    np.testing.assert_array_equal(white ^ white[0, 0], half[:, None] ^ half[None, :])


def test_lambert_light_on_a_plain_floor() -> None:
    # A lamp of strength 1 and endless reach 2 m over the origin: the cosine at (x, y) is 2 / √(4 + x² + y²).
    camera = Camera(8, 8, math.radians(90.0), (0.0, 0.0, 1.0), 0.0, math.radians(90.0))
    seen = Seen(*cast_ids(primitive_arrays(()), camera, (8, 8)), ray_grid(camera, (8, 8)))
    surfaces = surfaces_of(PLAIN, scale_m=1.0)._replace(colours=np.ones((1, 2, 3)))
    light = shade_cells(seen, surfaces, np.array([[0.0, 0.0, 2.0, 1.0, 1e9]]), 0.25, np.zeros((2, 3)))
    x = (np.arange(8) - 3.5) / 4.0
    expected = 0.25 + 2.0 / np.sqrt(4.0 + x[:, None] ** 2 + x[None, :] ** 2)
    np.testing.assert_allclose(light[..., 0], expected, rtol=1e-5)
