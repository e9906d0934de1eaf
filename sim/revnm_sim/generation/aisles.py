"""Halls with rows of shelves: aisles, gaps in the rows, dead ends. Made by seed; imports numpy only.

Every row has an opening, at one of its ends or in it, so every aisle can be reached. Evaluation seeds are for choosing
between models: the reported evaluation does not use this family.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from revnm_client.geometry import Pose2
from revnm_sim.generation.features import Part, Rng, pillar
from revnm_sim.generation.generator import is_training_seed
from revnm_sim.generation.room_builder import RoomBuilder
from revnm_sim.world import Shape, World

_SIDE_M = (9.0, 14.0)
_AISLE_M = (1.2, 2.2)
_SHELF_DEPTH_M = (0.4, 0.9)
_SHELF_HEIGHT_M = (1.2, 2.2)
_UNIT_M = 1.8
_OPENING_M = (1.0, 1.5)
_CLOSED_END_SHARE = 0.3
_CAP_SHARE = 0.4
_CAP_DEPTH_M = 0.4
_MOST_PILLARS = 4

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of shelves along x.

    Attributes:
        y_m: Its middle.
        depth_m: Its extent along y.
        height_m: Of all its shelves.
        spans: From and to, metres along x, of the pieces between the gaps.
        closed: Whether its left and its right end touch the wall.
    """

    y_m: float
    depth_m: float
    height_m: float
    spans: list[Span]
    closed: tuple[bool, bool]


def aisles(seed: int) -> World:
    """Return the hall of a seed: 9 to 14 m wide, with rows of shelves 1.2 to 2.2 m high.

    The world frame's origin is in the hall's middle; rows run along x or along y.

    Raises:
        ConfigError: The seed is negative.
    """
    kind = "training" if is_training_seed(seed) else "evaluation"
    rng = np.random.default_rng([seed, 3])
    builder = RoomBuilder(rng, width_m=rng.uniform(*_SIDE_M), depth_m=rng.uniform(*_SIDE_M))
    builder.outer_walls(height_m=rng.uniform(2.5, 4.5))
    frame = Pose2(0.0, 0.0, float(rng.integers(2)) * math.pi / 2.0)
    half_x, half_y = builder.half_m if frame.yaw_rad == 0.0 else builder.half_m[::-1]
    rows = _rows(rng, half_x, half_y)
    for row in rows:
        for unit in _units(row):
            builder.stand([unit], frame, row.height_m)
    for cap, height in _caps(rng, rows):
        builder.stand([cap], frame, height)
    for _ in range(int(rng.integers(_MOST_PILLARS + 1))):
        builder.add_island(pillar(rng, width_m=(0.2, 0.6)), height_m=rng.uniform(0.3, 1.5))
    return builder.world(f"aisles-{kind}-{seed}")


def _rows(rng: Rng, half_x_m: float, half_y_m: float) -> list[_Row]:
    """Draw rows of shelves with an aisle before, between and after them."""
    rows = []
    y = -half_y_m + rng.uniform(*_AISLE_M)
    depth = rng.uniform(*_SHELF_DEPTH_M)
    while y + depth + _AISLE_M[0] <= half_y_m:
        rows.append(_row(rng, y + depth / 2.0, depth, half_x_m))
        y += depth + rng.uniform(*_AISLE_M)
        depth = rng.uniform(*_SHELF_DEPTH_M)
    return rows


def _row(rng: Rng, y_m: float, depth_m: float, half_x_m: float) -> _Row:
    """Draw a row: its ends closed or open, and gaps in it, one at least where both ends are closed."""
    closed = (bool(rng.random() < _CLOSED_END_SHARE), bool(rng.random() < _CLOSED_END_SHARE))
    low, high = (0.0 if end else rng.uniform(*_OPENING_M) for end in closed)
    start, stop = low - half_x_m, half_x_m - high
    gaps = int(rng.integers(1 if all(closed) else 0, 3))
    spans, cell = [], (stop - start) / max(gaps, 1)
    edge = start
    for i in range(gaps):
        width = rng.uniform(*_OPENING_M)
        left = start + i * cell + rng.uniform(0.5, cell - width - 0.5)
        spans.append((edge, left))
        edge = left + width
    return _Row(y_m, depth_m, float(rng.uniform(*_SHELF_HEIGHT_M)), [*spans, (edge, stop)], closed)


def _units(row: _Row) -> list[Part]:
    """Cut the pieces of a row into shelves of about equal length."""
    units = []
    for low, high in row.spans:
        edges = np.linspace(low, high, 1 + math.ceil((high - low) / _UNIT_M))
        for left, right in pairwise(edges):
            units.append(Part(Shape.BOX, (left + right) / 2.0, row.y_m, 0.0, right - left, row.depth_m))
    return units


def _caps(rng: Rng, rows: list[_Row]) -> list[tuple[Part, float]]:
    """Draw shelves that close one end of every other aisle at most, with their heights.

    Behind a cap both rows are open, so that one gets past it; and one of the rows has another opening, so that one
    gets into the aisle.
    """
    caps = []
    for below, above in zip(rows[::2], rows[1::2], strict=False):
        side = int(rng.integers(2))
        wanted = rng.random() < _CAP_SHARE
        others = sum(len(row.spans) - 1 + (not row.closed[1 - side]) for row in (below, above))
        if not wanted or below.closed[side] or above.closed[side] or not others:
            continue
        low, high = below.y_m + below.depth_m / 2.0, above.y_m - above.depth_m / 2.0
        if side:
            end = min(below.spans[-1][1], above.spans[-1][1])
            x = end - _CAP_DEPTH_M / 2.0
        else:
            end = max(below.spans[0][0], above.spans[0][0])
            x = end + _CAP_DEPTH_M / 2.0
        caps.append((Part(Shape.BOX, x, (low + high) / 2.0, 0.0, _CAP_DEPTH_M, high - low), below.height_m))
    return caps
