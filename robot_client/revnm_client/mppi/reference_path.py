"""The part of the plan that lies ahead of the robot, evenly spaced."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class ReferencePath:
    """What is left of the plan.

    Attributes:
        points_m: (P, 2), P ≥ 1, robot frame, from the point of the plan nearest to the robot to its end.
        spacing_m: Path length between two of them; the last step may be shorter.
    """

    points_m: FloatArray
    spacing_m: float

    def at(self, length_m: float) -> FloatArray:
        """Return the point (2,) about ``length_m`` along the path, or its end."""
        return np.asarray(self.points_m[self.index(length_m)])

    def index(self, length_m: float) -> int:
        """Return the index of that point."""
        return min(round(length_m / self.spacing_m), len(self.points_m) - 1)


def path_ahead(waypoints_m: FloatArray, *, spacing_m: float = 0.1) -> ReferencePath:
    """Cut off what the robot has passed already, and space the rest evenly.

    Args:
        waypoints_m: (H, 2), H ≥ 1, robot frame; repeated points are fine.
        spacing_m: Path length between two points of the result.
    """
    steps = waypoints_m[1:] - waypoints_m[:-1]
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    moves = lengths > 1e-6
    lengths = lengths[moves]
    if not len(lengths):
        return ReferencePath(waypoints_m[:1], spacing_m)
    x, y = waypoints_m[np.append(True, moves)].T
    along = np.append(0.0, lengths.cumsum())  # path length at each point
    start, end = _nearest_length(x, y, along), float(along[-1])
    count = max(math.ceil((end - start) / spacing_m - 1e-9), 0)
    at = start + spacing_m * np.arange(count + 1)
    at[-1] = end
    return ReferencePath(np.stack([np.interp(at, along, x), np.interp(at, along, y)], axis=1), spacing_m)


def _nearest_length(x_m: FloatArray, y_m: FloatArray, along_m: FloatArray) -> float:
    """Return the path length at which the path is nearest to the robot, that is, to (0, 0)."""
    lengths = np.diff(along_m)
    dx, dy = np.diff(x_m) / lengths, np.diff(y_m) / lengths
    feet = np.clip(-(x_m[:-1] * dx + y_m[:-1] * dy), 0.0, lengths)
    best = int(np.argmin((x_m[:-1] + feet * dx) ** 2 + (y_m[:-1] + feet * dy) ** 2))
    return float(along_m[best] + feet[best])
