"""Pictures with exact disparity for the depth network: training worlds, random cameras, textures and light.

Every world gives a few pictures, each from another camera and with the robot, its tag on top, somewhere in it. Imports
neither torch nor PyBullet.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import Pose2
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.occupancy import OccupancyGrid, occupancy
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, robot_primitive
from revnm_sim.robot import RobotSpec
from revnm_sim.shade import shade
from revnm_sim.world import Primitive, Shape, World, primitive_arrays
from revnm_training.cache import Arrays, Block, Column, cut_blocks, fill_cache
from revnm_training.sample_set import VALIDATION_SHARE
from revnm_training.samples import build_world
from revnm_training.states import make_scene
from revnm_training.synth import FAMILIES, WORLDS_PER_SEED, draw_camera

FORMAT = 3
_PER_WORLD = 4
_WORLDS_PER_BLOCK = 10
_EMPTY_SHARE = 0.1
_PLATE_M = 0.004


@dataclass(frozen=True, slots=True)
class PictureSet:
    """Rendered pictures, memory-mapped.

    Attributes:
        columns: ``rgb`` (M, h, w, 3) uint8 and ``disparity`` (M, h, w) float16, 1/m, 0 for sky.
        train: Numbers of the pictures to train on.
        validation: Numbers of held-out pictures: of other worlds.
    """

    columns: dict[str, NDArray[Any]]
    train: NDArray[np.int64]
    validation: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PictureRenderer:
    """Renders blocks of pictures; see :class:`revnm_training.cache.Renderer`."""

    hw: tuple[int, int]
    seed: int

    def __call__(self, block: Block) -> Arrays:
        """Return the columns of a block."""
        rgb: list[NDArray[np.uint8]] = []
        disparity: list[Image32] = []
        number, attempt = block.start // _PER_WORLD, 0
        while len(rgb) < block.stop - block.start:
            rng = np.random.default_rng((self.seed, number, attempt))
            try:
                pairs = _world_pictures(self.seed, number, self.hw, rng)
            except ContractError:  # no camera sees enough of this world
                attempt += 1
                continue
            number, attempt = number + 1, 0
            rgb += [picture for picture, _ in pairs]
            disparity += [exact for _, exact in pairs]
        return {"rgb": np.stack(rgb), "disparity": np.stack(disparity)}


def render_pictures(folder: Path, hw: tuple[int, int], *, pictures: int, jobs: int, seed: int = 0) -> PictureSet:
    """Render pictures into a cache, or open it where that is done.

    Args:
        folder: Folder of the cache.
        hw: Height and width of the pictures.
        pictures: At least this many.
        jobs: Processes.
        seed: Of everything random.

    Raises:
        ConfigError: The folder holds a cache of another recipe.
    """
    count = -(-pictures // _PER_WORLD) * _PER_WORLD
    arrays = fill_cache(
        folder,
        recipe={"format": FORMAT, "hw": list(hw), "pictures": count, "seed": seed},
        columns={"rgb": Column("uint8", (*hw, 3)), "disparity": Column("float16", hw)},
        blocks=cut_blocks(count, _PER_WORLD * _WORLDS_PER_BLOCK),
        render=PictureRenderer(hw, seed),
        jobs=jobs,
    )
    held_out = max(1, round(VALIDATION_SHARE * count / _PER_WORLD)) * _PER_WORLD
    return PictureSet(arrays, np.arange(count - held_out), np.arange(count - held_out, count))


def _world_pictures(
    seed: int, number: int, hw: tuple[int, int], rng: np.random.Generator
) -> list[tuple[NDArray[np.uint8], Image32]]:
    family = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    # From the far end of the seed's worlds: the policy's episodes count from the other.
    world = build_world(family, TRAINING_SEED_BASE + (seed + 1) * WORLDS_PER_SEED - 1 - number)
    grid = occupancy(world)
    return [_picture(world, grid, draw_camera(world, rng), hw, rng) for _ in range(_PER_WORLD)]


def _picture(
    world: World, grid: OccupancyGrid, camera: Camera, hw: tuple[int, int], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], Image32]:
    robot = RobotSpec()
    places = make_scene(world, camera, grid, robot, rng).pool_m
    extra: tuple[Primitive, ...] = ()
    if len(places) and rng.random() >= _EMPTY_SHARE:
        x, y = places[rng.integers(len(places))]
        pose = Pose2(x, y, rng.uniform(-np.pi, np.pi))
        extra = (robot_primitive(pose, robot), _tag_plate(pose, robot))
    picture = shade(world, camera, (hw[1], hw[0]), rng, extra=extra)
    depth = cast_depth(primitive_arrays(world.primitives + extra), camera, hw)
    return picture, disparity_from_depth(depth)


def _tag_plate(pose: Pose2, robot: RobotSpec) -> Primitive:
    """Return the tag as a thin bright plate on the robot's top."""
    return Primitive(
        shape=Shape.BOX,
        centre_m=(pose.x_m, pose.y_m, robot.top_m),
        size_m=(robot.tag_m, robot.tag_m, _PLATE_M),
        yaw_rad=pose.yaw_rad,
        colour=(225, 225, 225),
    )
