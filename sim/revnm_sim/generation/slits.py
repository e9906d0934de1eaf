"""Halls cut by walls from side to side, with doors to drive through and slits that only rays pass.

Made by seed; imports numpy only. Every wall has a door, so every part can be reached.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2
from revnm_sim.generation.features import pillar, wall
from revnm_sim.generation.generator import is_training_seed
from revnm_sim.generation.room_builder import RoomBuilder
from revnm_sim.generation.rooms import wall_with_openings
from revnm_sim.world import World

_SIDE_M = (8.0, 14.0)
_APART_M = (1.7, 4.0)
_HEIGHT_M = (0.4, 2.2)
_DOOR_M = (0.75, 1.3)
_THICK_M = (0.08, 0.5)
_MOST_SLITS = 5
_SECOND_DOOR_SHARE = 0.4
_MOST_PILLARS = 6
_SLANT_RAD = 0.05


def slits(seed: int) -> World:
    """Return the hall of a seed: 8 to 14 m wide, cut by 1 to 6 walls 0.4 to 2.2 m high.

    The world frame's origin is in the hall's middle; the walls run about along x or about along y.

    Raises:
        ConfigError: The seed is negative.
    """
    kind = "training" if is_training_seed(seed) else "evaluation"
    rng = np.random.default_rng([seed, 5])
    builder = RoomBuilder(rng, width_m=rng.uniform(*_SIDE_M), depth_m=rng.uniform(*_SIDE_M))
    builder.outer_walls(height_m=rng.uniform(2.5, 4.5))
    frame = Pose2(0.0, 0.0, float(rng.integers(2)) * math.pi / 2.0)
    half_x, half_y = builder.half_m if frame.yaw_rad == 0.0 else builder.half_m[::-1]
    y = -half_y + rng.uniform(*_APART_M)
    while y < half_y - _APART_M[0]:
        doors = 2 if rng.random() < _SECOND_DOOR_SHARE else 1
        pieces, _ = wall_with_openings(
            rng, 2.0 * half_x, doors=doors, slits=_MOST_SLITS + 1, door_m=_DOOR_M, thick_m=_THICK_M
        )
        slant = rng.uniform(-_SLANT_RAD, _SLANT_RAD) if rng.random() < 0.5 else 0.0
        along = Pose2(-half_x, y - half_x * math.sin(slant), slant)
        builder.stand(pieces, frame @ along, rng.uniform(*_HEIGHT_M))
        y += rng.uniform(*_APART_M)
    for _ in range(int(rng.integers(_MOST_PILLARS + 1))):
        part = pillar(rng, width_m=(0.2, 0.6)) if rng.integers(2) else wall(rng, length_m=(0.6, 1.6))
        builder.add_island(part, height_m=rng.uniform(0.3, 1.5))
    return builder.world(f"slits-{kind}-{seed}")
