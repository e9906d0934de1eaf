"""Builds rooms from features: outer walls, islands, dividers and spurs, with passages between them.

Between any two features that it places there are at least :data:`PASSAGE_M`, so every piece of floor can be reached.
Imports numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.generation.features import Part, divider, spur
from revnm_sim.world import Bounds, Primitive, PrimitiveArrays, Shape, World, primitive_arrays

PASSAGE_M = 0.85
_ATTEMPTS = 25
_OUTER_WALLS = 4

Colour = tuple[int, int, int]


class RoomBuilder:
    """Collects primitives in a room, its middle at the origin, and keeps passages between them open.

    Attributes:
        half_m: Half the room's extents (x, y).
        islands: How many islands have found a place.
    """

    def __init__(self, rng: np.random.Generator, *, width_m: float, depth_m: float) -> None:
        self._rng = rng
        self.half_m = (width_m / 2.0, depth_m / 2.0)
        self._primitives: list[Primitive] = []
        self._standing = primitive_arrays(())
        self.islands = 0

    def world(self, name: str) -> World:
        """Return the room with what stands in it, and a floor of some colour."""
        x, y = self.half_m
        return World(name, Bounds(-x, -y, x, y), self.draw_colour(), tuple(self._primitives))

    def outer_walls(self, *, height_m: float) -> None:
        """Stand four walls outside the floor; they overlap at the corners."""
        x, y = self.half_m
        thick = self._rng.uniform(0.1, 0.2)
        colour = self.draw_colour()
        out = thick / 2.0
        walls = (
            Part(Shape.BOX, x + out, 0.0, 0.0, thick, 2.0 * (y + thick)),
            Part(Shape.BOX, -x - out, 0.0, 0.0, thick, 2.0 * (y + thick)),
            Part(Shape.BOX, 0.0, y + out, 0.0, 2.0 * (x + thick), thick),
            Part(Shape.BOX, 0.0, -y - out, 0.0, 2.0 * (x + thick), thick),
        )
        self._primitives += [_primitive(part, height_m, colour) for part in walls]

    def add_island(self, parts: Sequence[Part], *, height_m: float) -> None:
        """Stand parts somewhere with a passage all around them; leave them out where there is no room."""
        outline = _outline(parts)
        for _ in range(_ATTEMPTS):
            x, y = (self._rng.uniform(-half, half) for half in self.half_m)
            frame = Pose2(x, y, self._rng.uniform(-math.pi, math.pi))
            points = frame.apply(outline)
            if self._wall_gap_m(points) >= PASSAGE_M and self._gap_m(points) >= PASSAGE_M:
                self.stand(parts, frame, height_m)
                self.islands += 1
                return

    def add_divider(self) -> None:
        """Stand a wall with gaps from side to side; leave it out where it comes too near to another."""
        for _ in range(_ATTEMPTS):
            along_x = bool(self._rng.integers(2))
            length, across = self.half_m if along_x else self.half_m[::-1]
            offset = self._rng.uniform(-0.6, 0.6) * across
            frame = Pose2(0.0, offset, 0.0) if along_x else Pose2(offset, 0.0, math.pi / 2.0)
            parts = divider(self._rng, length_m=2.0 * length)
            if self._gap_m(frame.apply(_outline(parts))) >= 2.0 * PASSAGE_M:
                self.stand(parts, frame, self._rng.uniform(0.4, 1.6))
                return

    def add_spur(self) -> None:
        """Stand a wall that starts at an outer wall; leave it out where there is no room."""
        for _ in range(_ATTEMPTS):
            side = int(self._rng.integers(4))
            inwards, along = self.half_m if side % 2 == 0 else self.half_m[::-1]
            offset = self._rng.uniform(-1.0, 1.0) * (along - PASSAGE_M - 0.2)
            frame = Pose2(0.0, 0.0, side * math.pi / 2.0) @ Pose2(inwards, offset, math.pi)
            parts = spur(self._rng, longest_m=1.3 * inwards)
            outline = _outline(parts)
            points, beyond = frame.apply(outline), outline[:, 0] > PASSAGE_M  # its own wall is near at first
            if self._gap_m(points) >= PASSAGE_M and self._wall_gap_m(points[beyond]) >= PASSAGE_M:
                self.stand(parts, frame, self._rng.uniform(0.4, 1.6))
                return

    def stand(self, parts: Sequence[Part], frame: Pose2, height_m: float) -> None:
        """Stand parts of one colour in a frame, wherever that is."""
        colour = self.draw_colour()
        self._primitives += [_primitive(part.moved(frame), height_m, colour) for part in parts]
        self._standing = primitive_arrays(tuple(self._primitives[_OUTER_WALLS:]))

    def draw_colour(self) -> Colour:
        """Draw a colour, neither black nor white."""
        r, g, b = (int(c) for c in self._rng.integers(30, 231, size=3))
        return r, g, b

    def _gap_m(self, points_m: FloatArray) -> float:
        return float(_distance_m(points_m, self._standing).min(initial=np.inf))

    def _wall_gap_m(self, points_m: FloatArray) -> float:
        return float((np.array(self.half_m) - np.abs(points_m)).min())


def _primitive(part: Part, height_m: float, colour: Colour) -> Primitive:
    """Stand a part of a plan upright on the floor."""
    return Primitive(
        part.shape,
        (part.x_m, part.y_m, height_m / 2.0),
        (part.length_m, part.width_m, height_m),
        part.yaw_rad,
        colour,
    )


def _outline(parts: Sequence[Part]) -> FloatArray:
    """Return points (M, 2) on the outlines of a feature's parts, in the feature's frame."""
    return np.concatenate([part.outline() for part in parts])


def _distance_m(points_m: FloatArray, standing: PrimitiveArrays) -> FloatArray:
    """Return the distances (P, M) of points (M, 2) from the footprints of P primitives, 0 inside."""
    offset = points_m[None] - standing.centre_m[:, None, :2]  # (P, M, 2)
    c, s = standing.axis[:, :1], standing.axis[:, 1:]
    along = np.abs(c * offset[..., 0] + s * offset[..., 1])
    across = np.abs(c * offset[..., 1] - s * offset[..., 0])
    half = standing.half_m
    box = np.hypot(np.maximum(along - half[:, :1], 0.0), np.maximum(across - half[:, 1:2], 0.0))
    disc = np.maximum(np.hypot(along, across) - half[:, :1], 0.0)
    return np.where(standing.shape[:, None] == Shape.CYLINDER, disc, box)
