"""Flats: rooms behind low walls with doors, and slits that one sees through but does not fit through.

Made by seed; imports numpy only. Every wall has a door and no wall ends in front of another's door, so every room can
be reached. Evaluation seeds are for choosing between models: the reported evaluation does not use this family.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from revnm_client.geometry import Pose2
from revnm_sim.generation.features import Part, Rng, pillar
from revnm_sim.generation.generator import is_training_seed
from revnm_sim.generation.room_builder import RoomBuilder
from revnm_sim.world import Shape, World

_SIDE_M = (9.0, 13.0)
_WALL_HEIGHT_M = (0.5, 1.6)
_LEAST_ROOM_M = 2.6
_DOOR_M = (0.9, 1.2)
_SLIT_M = (0.15, 0.3)
_DOOR_MARGIN_M = 0.3  # between a door and what stands at a right angle to its wall
_SECOND_DOOR_SHARE = 0.3
_SPLITS = (3, 6)
_MOST_FURNITURE = 8
_ATTEMPTS = 20


class _Room(NamedTuple):
    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


class _Door(NamedTuple):
    """The middle of an opening to drive through."""

    x_m: float
    y_m: float


def rooms(seed: int) -> World:
    """Return the flat of a seed: 9 to 13 m wide, 4 to 7 rooms, inner walls 0.5 to 1.6 m high.

    The world frame's origin is in the flat's middle.

    Raises:
        ConfigError: The seed is negative.
    """
    kind = "training" if is_training_seed(seed) else "evaluation"
    rng = np.random.default_rng([seed, 4])
    builder = RoomBuilder(rng, width_m=rng.uniform(*_SIDE_M), depth_m=rng.uniform(*_SIDE_M))
    builder.outer_walls(height_m=rng.uniform(2.5, 4.0))
    x, y = builder.half_m
    parts = [_Room(-x, -y, x, y)]
    doors: list[_Door] = []
    for _ in range(int(rng.integers(_SPLITS[0], _SPLITS[1] + 1))):
        largest = max(parts, key=lambda room: (room.x_max_m - room.x_min_m) * (room.y_max_m - room.y_min_m))
        halves = _split(rng, builder, largest, doors)
        if halves:
            parts.remove(largest)
            parts += halves
    for _ in range(int(rng.integers(3, _MOST_FURNITURE + 1))):
        builder.add_island(_furniture(rng), height_m=rng.uniform(0.3, 1.2))
    return builder.world(f"rooms-{kind}-{seed}")


def _split(rng: Rng, builder: RoomBuilder, room: _Room, doors: list[_Door]) -> list[_Room]:
    """Stand a wall across the longer side of a room and note its doors; return the halves, none if it does not fit."""
    width, depth = room.x_max_m - room.x_min_m, room.y_max_m - room.y_min_m
    across_x = width >= depth  # the wall runs along y
    low, high = (room.x_min_m, room.x_max_m) if across_x else (room.y_min_m, room.y_max_m)
    start, stop = (room.y_min_m, room.y_max_m) if across_x else (room.x_min_m, room.x_max_m)
    if high - low < 2.0 * _LEAST_ROOM_M:
        return []
    for _ in range(_ATTEMPTS):
        at = float(rng.uniform(low + _LEAST_ROOM_M, high - _LEAST_ROOM_M))
        ends = (_Door(at, start), _Door(at, stop)) if across_x else (_Door(start, at), _Door(stop, at))
        if all(_clear(end, door) for end in ends for door in doors):
            break
    else:
        return []
    frame = Pose2(at, start, math.pi / 2.0) if across_x else Pose2(start, at, 0.0)
    doors_here = 2 if stop - start > 5.0 and rng.random() < _SECOND_DOOR_SHARE else 1
    pieces, openings = wall_with_openings(rng, stop - start, doors=doors_here, slits=3)
    builder.stand(pieces, frame, rng.uniform(*_WALL_HEIGHT_M))
    doors += [_Door(at, start + along) if across_x else _Door(start + along, at) for along in openings]
    if across_x:
        return [room._replace(x_max_m=at), room._replace(x_min_m=at)]
    return [room._replace(y_max_m=at), room._replace(y_min_m=at)]


def _clear(end: _Door, door: _Door) -> bool:
    """Tell whether a wall that ends at a place leaves a door free."""
    return math.hypot(end.x_m - door.x_m, end.y_m - door.y_m) > _DOOR_M[1] / 2.0 + _DOOR_MARGIN_M


def wall_with_openings(
    rng: Rng,
    length_m: float,
    *,
    doors: int,
    slits: int,
    door_m: tuple[float, float] = _DOOR_M,
    thick_m: tuple[float, float] = (0.1, 0.2),
) -> tuple[list[Part], list[float]]:
    """Draw a wall along x from the origin with doors and slits.

    Args:
        rng: Decides the draws.
        length_m: Of the wall.
        doors: Openings to drive through.
        slits: There are fewer openings than this that one only sees through.
        door_m: Least and greatest width of a door.
        thick_m: Least and greatest thickness.

    Returns:
        Its pieces, and where the middles of the doors are along it.
    """
    widths = [
        *(rng.uniform(*door_m) for _ in range(doors)),
        *(rng.uniform(*_SLIT_M) for _ in range(rng.integers(slits))),
    ]
    order = rng.permutation(len(widths))
    # Share out what is left over between the openings and at the ends, 0.3 m everywhere at least.
    spare = length_m - sum(widths) - _DOOR_MARGIN_M * (len(widths) + 1)
    solid = _DOOR_MARGIN_M + spare * rng.dirichlet(np.ones(len(widths) + 1))
    thick = float(rng.uniform(*thick_m))
    pieces, middles, edge = [], [], 0.0
    for length, i in zip(solid, order, strict=False):
        pieces.append(Part(Shape.BOX, edge + length / 2.0, 0.0, 0.0, float(length), thick))
        if i < doors:
            middles.append(float(edge + length + widths[i] / 2.0))
        edge = float(edge + length + widths[i])
    pieces.append(Part(Shape.BOX, (edge + length_m) / 2.0, 0.0, 0.0, length_m - edge, thick))
    return pieces, middles


def _furniture(rng: Rng) -> list[Part]:
    """Draw a table, or something small."""
    if rng.integers(2):
        return [Part(Shape.BOX, 0.0, 0.0, 0.0, float(rng.uniform(0.6, 1.4)), float(rng.uniform(0.4, 0.8)))]
    return pillar(rng, width_m=(0.25, 0.6))
