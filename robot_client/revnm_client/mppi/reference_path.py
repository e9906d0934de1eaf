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
    steps = np.diff(waypoints_m, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    keep = np.concatenate([[True], lengths > 1e-6])
    points, lengths = waypoints_m[keep], lengths[keep[1:]]
    if len(points) == 1:
        return ReferencePath(points, spacing_m)
    along = np.concatenate([[0.0], np.cumsum(lengths)])  # path length at each point
    start = _nearest_length(points, lengths, along)
    count = max(math.ceil((along[-1] - start) / spacing_m - 1e-9), 0)
    at = np.append(start + spacing_m * np.arange(count), along[-1])
    return ReferencePath(np.stack([np.interp(at, along, points[:, i]) for i in (0, 1)], axis=1), spacing_m)


def _nearest_length(points: FloatArray, lengths: FloatArray, along: FloatArray) -> float:
    """Return the path length at which the path is nearest to the robot, that is, to (0, 0)."""
    directions = np.diff(points, axis=0) / lengths[:, None]
    feet = np.clip(-(points[:-1] * directions).sum(axis=1), 0.0, lengths)
    nearest = points[:-1] + feet[:, None] * directions
    best = int(np.argmin((nearest**2).sum(axis=1)))
    return float(along[best] + feet[best])
