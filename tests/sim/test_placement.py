"""Camera poses: inside, near a wall, clear of obstacles, seeing the floor; refused where nothing fits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_sim.camera import Camera
from revnm_sim.generation.placement import sample_camera
from revnm_sim.rays.raycast import visible
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

SIDE_M = 10.0
GREY = (120, 120, 120)


def room(seed: int, count: int = 20) -> World:
    rng = np.random.default_rng(seed)
    half = SIDE_M / 2.0
    found = [
        Primitive(Shape.BOX, (x, y, 1.5), (along, across, 3.0), 0.0, GREY)
        for x, y, along, across in (
            (-0.1, half, 0.2, SIDE_M),
            (SIDE_M + 0.1, half, 0.2, SIDE_M),
            (half, -0.1, SIDE_M, 0.2),
            (half, SIDE_M + 0.1, SIDE_M, 0.2),
        )
    ]
    for _ in range(count):
        x, y = rng.uniform(0.0, SIDE_M, 2)
        width, height = rng.uniform(0.2, 1.0), rng.uniform(0.3, 2.0)
        shape = Shape(int(rng.integers(2)))
        found.append(Primitive(shape, (x, y, height / 2.0), (width, width, height), rng.uniform(-3.0, 3.0), GREY))
    return World("room", Bounds(0.0, 0.0, SIDE_M, SIDE_M), GREY, tuple(found))


def sample(world: World, seed: int) -> Camera:
    rng = np.random.default_rng(seed)
    return sample_camera(world, rng, width_px=640, height_px=480, hfov_rad=math.radians(120.0))


@pytest.mark.parametrize("seed", range(10))
def test_camera_stands_by_a_wall_and_sees_the_floor(seed: int) -> None:
    world = room(seed)
    camera = sample(world, seed)
    x, y, z = camera.position_m
    from_wall = min(x, SIDE_M - x, y, SIDE_M - y)
    assert 0.2 <= from_wall <= 0.8
    assert 1.8 <= z <= 4.0
    assert math.radians(15.0) <= camera.pitch_rad <= math.radians(50.0)
    towards = np.array([SIDE_M / 2.0 - x, SIDE_M / 2.0 - y])
    assert towards @ [math.cos(camera.yaw_rad), math.sin(camera.yaw_rad)] > 0.0
    # Random points of the whole floor: those under things are never seen, and still most are.
    points = np.column_stack([np.random.default_rng(1).uniform(0.0, SIDE_M, (2000, 2)), np.zeros(2000)])
    assert visible(primitive_arrays(world.primitives), camera, points).mean() > 0.4


def test_camera_keeps_clear_of_obstacles() -> None:
    # A tall pillar fills the belt along two of the walls: the camera stands elsewhere.
    blocks = tuple(
        Primitive(Shape.BOX, centre, size, 0.0, GREY)
        for centre, size in (((0.5, 5.0, 2.5), (1.0, 10.0, 5.0)), ((5.0, 0.5, 2.5), (10.0, 1.0, 5.0)))
    )
    world = room(3, count=0)
    world = World("blocked", world.bounds, GREY, world.primitives + blocks)
    for seed in range(10):
        x, y, _ = sample(world, seed).position_m
        assert min(x, y) > 1.1


def test_same_generator_state_gives_the_same_camera() -> None:
    assert sample(room(1), 5) == sample(room(1), 5)
    assert sample(room(1), 5) != sample(room(1), 6)


def test_ranges_are_kept() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        camera = sample_camera(
            room(0),
            rng,
            width_px=1280,
            height_px=720,
            hfov_rad=1.4,
            height_range_m=(2.9, 3.0),
            pitch_range_rad=(0.5, 0.6),
        )
        assert (camera.width_px, camera.height_px, camera.hfov_rad) == (1280, 720, 1.4)
        assert 2.9 <= camera.position_m[2] <= 3.0
        assert 0.5 <= camera.pitch_rad <= 0.6


def test_full_room_is_refused() -> None:
    block = Primitive(Shape.BOX, (5.0, 5.0, 3.0), (10.0, 10.0, 6.0), 0.0, GREY)
    world = World("solid", Bounds(0.0, 0.0, SIDE_M, SIDE_M), GREY, (block,))
    with pytest.raises(ContractError, match="solid"):
        sample(world, 0)


def test_belt_without_a_clear_place_is_refused() -> None:
    # Walls 1 m thick inside the bounds: the middle is free floor, but every place by the wall lies within them.
    walls = tuple(
        Primitive(Shape.BOX, (x, y, 2.5), (along, across, 5.0), 0.0, GREY)
        for x, y, along, across in (
            (0.5, 5.0, 1.0, 10.0),
            (9.5, 5.0, 1.0, 10.0),
            (5.0, 0.5, 10.0, 1.0),
            (5.0, 9.5, 10.0, 1.0),
        )
    )
    with pytest.raises(ContractError, match="clear of the obstacles"):
        sample(World("thick", Bounds(0.0, 0.0, SIDE_M, SIDE_M), GREY, walls), 0)
