"""Worlds made by seed: rooms with pillars, walls, pockets and dividers, built from boxes and cylinders.

Training worlds and evaluation worlds never meet: their seeds lie on two sides of :data:`TRAINING_SEED_BASE`.
Pockets and walls trap whoever goes straight to the goal, yet every piece of floor can be reached. Imports numpy only.
"""

from __future__ import annotations

import numpy as np

from revnm_client.errors import ConfigError
from revnm_sim.generation.features import LAYOUTS, MAKERS, pillar, wall
from revnm_sim.generation.room_builder import RoomBuilder
from revnm_sim.world import World

TRAINING_SEED_BASE = 1_000_000_000
_DEMO_DRAWS = 40


def is_training_seed(seed: int) -> bool:
    """Tell on which side a world's seed lies: training from :data:`TRAINING_SEED_BASE` on, evaluation below.

    Raises:
        ConfigError: The seed is negative, so no world's.
    """
    if seed < 0:
        raise ConfigError(f"world seed {seed} is negative: expected 0 or more")
    return seed >= TRAINING_SEED_BASE


def random_pillar(seed: int) -> World:
    """Return the room of a seed: 9 to 12 m wide, hard for a robot that goes straight, yet solvable.

    The world frame's origin is in the room's middle.

    Raises:
        ConfigError: The seed is negative.
    """
    kind = "training" if is_training_seed(seed) else "evaluation"
    rng = np.random.default_rng([seed, 0])
    builder = RoomBuilder(rng, width_m=rng.uniform(9.0, 12.0), depth_m=rng.uniform(9.0, 12.0))
    layout = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
    builder.outer_walls(height_m=rng.uniform(2.5, 4.0))
    for _ in range(layout.dividers.draw(rng)):
        builder.add_divider()
    for _ in range(layout.spurs.draw(rng)):
        builder.add_spur()
    for name, count in layout.islands.items():
        for _ in range(count.draw(rng)):
            builder.add_island(MAKERS[name](rng), height_m=rng.uniform(0.4, 2.0))
    for _ in range(layout.pillars.draw(rng)):
        builder.add_island(pillar(rng), height_m=rng.uniform(0.3, 2.0))
    return builder.world(f"random_pillar-{kind}-{seed}")


def demo_room(seed: int) -> World:
    """Return a room of about 6 × 5 m with 4 to 8 low obstacles, where a tag stays large in the picture.

    Raises:
        ConfigError: The seed is negative.
    """
    is_training_seed(seed)
    rng = np.random.default_rng([seed, 1])
    builder = RoomBuilder(rng, width_m=rng.uniform(5.7, 6.3), depth_m=rng.uniform(4.8, 5.2))
    builder.outer_walls(height_m=rng.uniform(3.6, 4.0))
    wanted = 4 + int(rng.integers(0, 5))
    builder.add_island(wall(rng, length_m=(0.8, 1.4)), height_m=rng.uniform(0.4, 0.7))
    for _ in range(_DEMO_DRAWS):
        if builder.islands < wanted:
            builder.add_island(pillar(rng, width_m=(0.2, 0.5)), height_m=rng.uniform(0.3, 0.9))
    return builder.world(f"demo_room-{seed}")
