"""What stands in generated rooms, seen from above: pillars, rows, walls, L- and U-shaped pockets, dividers.

Each maker draws a feature about its own origin as parts; the generator places and raises it. Imports numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.world import Shape

Rng = np.random.Generator
_OUTLINE_STEP_M = 0.1


@dataclass(frozen=True, slots=True)
class Part:
    """The footprint of one primitive.

    Attributes:
        shape: Box, or cylinder with ``length_m`` = ``width_m`` = diameter.
        x_m: Middle.
        y_m: Middle.
        yaw_rad: Turn of the length from the x axis.
        length_m: Full extent along its own x axis.
        width_m: Full extent along its own y axis.
    """

    shape: Shape
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float

    def moved(self, frame: Pose2) -> Part:
        """Return the part with the feature's origin at ``frame``."""
        pose = frame @ Pose2(self.x_m, self.y_m, self.yaw_rad)
        return replace(self, x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)

    def outline(self) -> FloatArray:
        """Return points (M, 2) on the outline, at most 0.1 m apart."""
        if self.shape is Shape.CYLINDER:
            angles = np.linspace(0.0, math.tau, 40, endpoint=False)
            local = 0.5 * self.length_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        else:
            a, b = self.length_m / 2.0, self.width_m / 2.0
            xs = np.linspace(-a, a, 2 + int(self.length_m / _OUTLINE_STEP_M))
            ys = np.linspace(-b, b, 2 + int(self.width_m / _OUTLINE_STEP_M))
            along = np.stack([xs, np.full_like(xs, b)], axis=1)
            across = np.stack([np.full_like(ys, a), ys], axis=1)
            local = np.concatenate([along, along * [1.0, -1.0], across, across * [-1.0, 1.0]])
        return Pose2(self.x_m, self.y_m, self.yaw_rad).apply(local)


class Count(NamedTuple):
    """How many of a feature a layout wants: from ``low`` to ``high``, both included."""

    low: int
    high: int

    def draw(self, rng: Rng) -> int:
        """Draw a number."""
        return int(rng.integers(self.low, self.high + 1))


@dataclass(frozen=True, slots=True)
class Layout:
    """How full a room is, and of what; larger things are placed before smaller ones.

    Attributes:
        dividers: Walls with gaps from side to side.
        spurs: Walls that start at an outer wall.
        islands: Free-standing features by their name in :data:`MAKERS`.
        pillars: Single pillars.
    """

    dividers: Count
    spurs: Count
    islands: Mapping[str, Count]
    pillars: Count


def pillar(rng: Rng, *, width_m: tuple[float, float] = (0.2, 1.0)) -> list[Part]:
    """Draw a box or a cylinder."""
    if rng.integers(2):
        diameter = rng.uniform(*width_m)
        return [Part(Shape.CYLINDER, 0.0, 0.0, 0.0, diameter, diameter)]
    return [Part(Shape.BOX, 0.0, 0.0, 0.0, rng.uniform(*width_m), rng.uniform(*width_m))]


def row(rng: Rng) -> list[Part]:
    """Draw a row of like pillars: either a fence that nobody passes, or a colonnade to drive through."""
    one = pillar(rng, width_m=(0.2, 0.5))[0]
    fence = bool(rng.integers(2))
    gap = rng.uniform(0.05, 0.25) if fence else rng.uniform(0.9, 1.3)
    pitch = one.length_m + gap
    count = int(rng.integers(4, 9)) if fence else int(rng.integers(3, 5))
    return [replace(one, x_m=(i - (count - 1) / 2.0) * pitch) for i in range(count)]


def wall(rng: Rng, *, length_m: tuple[float, float] = (2.5, 4.5)) -> list[Part]:
    """Draw a straight wall."""
    return [Part(Shape.BOX, 0.0, 0.0, 0.0, rng.uniform(*length_m), _thickness(rng))]


def pocket_l(rng: Rng) -> list[Part]:
    """Draw two walls that meet at a right angle."""
    thick = _thickness(rng)
    return _polyline([(rng.uniform(1.2, 3.0), 0.0), (0.0, 0.0), (0.0, rng.uniform(1.2, 3.0))], thick)


def pocket_u(rng: Rng) -> list[Part]:
    """Draw three walls around a dead end, open to one side."""
    half = rng.uniform(0.8, 1.6)
    left, right = rng.uniform(1.0, 2.2), rng.uniform(1.0, 2.2)
    return _polyline([(left, half), (0.0, half), (0.0, -half), (right, -half)], _thickness(rng))


def divider(rng: Rng, *, length_m: float) -> list[Part]:
    """Draw a wall along x from −length / 2 to length / 2 with one or two gaps to drive through."""
    thick = _thickness(rng)
    gaps = int(rng.integers(1, 3))
    cell = length_m / gaps
    parts, start = [], -length_m / 2.0
    for i in range(gaps):
        width = rng.uniform(0.95, 1.6)
        low = -length_m / 2.0 + i * cell + rng.uniform(0.1, cell - width - 0.1)
        parts.append(Part(Shape.BOX, (start + low) / 2.0, 0.0, 0.0, low - start, thick))
        start = low + width
    end = length_m / 2.0
    return [*parts, Part(Shape.BOX, (start + end) / 2.0, 0.0, 0.0, end - start, thick)]


def spur(rng: Rng, *, longest_m: float) -> list[Part]:
    """Draw a wall along x from the origin, sometimes with a hook at its end."""
    thick = _thickness(rng)
    length = rng.uniform(1.5, longest_m)
    points = [(0.0, 0.0), (length, 0.0)]
    if rng.random() < 0.6:
        side = 1.0 if rng.integers(2) else -1.0
        points.append((length, side * rng.uniform(0.8, 2.0)))
    return _polyline(points, thick)


def _thickness(rng: Rng) -> float:
    return float(rng.uniform(0.1, 0.3))


def _polyline(points: list[tuple[float, float]], thick_m: float) -> list[Part]:
    """Return walls along a polyline; each is longer by its thickness, which fills the corners."""
    parts = []
    for (x0, y0), (x1, y1) in pairwise(points):
        yaw, length = math.atan2(y1 - y0, x1 - x0), math.hypot(x1 - x0, y1 - y0)
        parts.append(Part(Shape.BOX, (x0 + x1) / 2.0, (y0 + y1) / 2.0, yaw, length + thick_m, thick_m))
    return parts


MAKERS: Mapping[str, Callable[[Rng], list[Part]]] = {
    "u": pocket_u,
    "l": pocket_l,
    "wall": wall,
    "row": row,
}

_NONE = Count(0, 0)
LAYOUTS = (
    Layout(_NONE, Count(0, 1), {"u": Count(4, 5), "wall": Count(2, 4)}, Count(5, 12)),  # scattered
    Layout(_NONE, Count(1, 2), {"u": Count(4, 5), "row": Count(2, 4)}, Count(3, 9)),  # rows
    Layout(_NONE, Count(2, 3), {"u": Count(4, 6), "l": Count(2, 4)}, Count(3, 8)),  # pockets
    Layout(Count(1, 2), Count(1, 3), {"u": Count(3, 4), "l": Count(1, 2)}, Count(3, 8)),  # chambers
    Layout(Count(1, 1), Count(2, 3), {"u": Count(2, 4), "l": Count(1, 3), "row": Count(0, 2)}, Count(4, 10)),
)
