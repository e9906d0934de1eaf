"""A world: a floor and what stands on it, as boxes and cylinders.

World frame: x, y in the floor, z up, metres. Imports numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

FLAT_M = 0.02


class Shape(IntEnum):
    """Kinds of primitives; the numbers are those of :class:`PrimitiveArrays`."""

    BOX = 0
    CYLINDER = 1


@dataclass(frozen=True, slots=True)
class Primitive:
    """A box, or an upright cylinder.

    Attributes:
        shape: Which of the two.
        centre_m: (x, y, z) of its middle, world frame.
        size_m: Full extents along its own axes; of a cylinder (diameter, diameter, height).
        yaw_rad: Turn about z.
        colour: RGB, 0 to 255.
    """

    shape: Shape
    centre_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float
    colour: tuple[int, int, int]

    @property
    def bottom_m(self) -> float:
        """Height of its lower end over the floor."""
        return self.centre_m[2] - self.size_m[2] / 2.0

    @property
    def top_m(self) -> float:
        """Height of its upper end over the floor."""
        return self.centre_m[2] + self.size_m[2] / 2.0


class Bounds(NamedTuple):
    """The rectangle of floor that a world covers, metres, world frame."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


@dataclass(frozen=True, slots=True)
class World:
    """A floor at z = 0 with primitives on it.

    Attributes:
        name: For reports.
        bounds: Where the robot may be; nothing is known beyond.
        floor_colour: RGB, 0 to 255.
        primitives: Everything that stands or hangs there, walls included.
    """

    name: str
    bounds: Bounds
    floor_colour: tuple[int, int, int]
    primitives: tuple[Primitive, ...]

    @property
    def obstacles(self) -> tuple[Primitive, ...]:
        """The primitives but for marks and mats: what ends 0.02 m over the floor is floor to robots and planners."""
        return tuple(primitive for primitive in self.primitives if primitive.top_m > FLAT_M)


class PrimitiveArrays(NamedTuple):
    """P primitives as arrays, the form that compiled loops read.

    Attributes:
        shape: (P,) int64, a :class:`Shape`.
        centre_m: (P, 3) float64.
        half_m: (P, 3) float64, half extents; of a cylinder (radius, radius, half height).
        axis: (P, 2) float64, cosine and sine of the yaw.
    """

    shape: NDArray[np.int64]
    centre_m: FloatArray
    half_m: FloatArray
    axis: FloatArray


def primitive_arrays(primitives: tuple[Primitive, ...]) -> PrimitiveArrays:
    """Lay primitives out as arrays."""
    yaw = np.array([p.yaw_rad for p in primitives], dtype=np.float64)
    return PrimitiveArrays(
        shape=np.array([p.shape for p in primitives], dtype=np.int64),
        centre_m=np.array([p.centre_m for p in primitives], dtype=np.float64).reshape(-1, 3),
        half_m=np.array([p.size_m for p in primitives], dtype=np.float64).reshape(-1, 3) / 2.0,
        axis=np.stack([np.cos(yaw), np.sin(yaw)], axis=-1),
    )
