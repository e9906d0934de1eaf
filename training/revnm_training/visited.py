"""Chooses which states of a drive the expert labels: those in which a learner most needs to be told what to do.

Source: Ross, Gordon and Bagnell, 2011, arXiv:1011.0686 (DAgger). Imports neither torch nor PyBullet.

Symbols: T control steps, S states.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_sim.expert.planner import INSCRIBED_M, CostToGo
from revnm_training.episodes import StateKind
from revnm_training.states import NEAR_M

_SHARE = 0.25  # of the states, for each of the three kinds of trouble; the rest is drawn from the whole drive
_STUCK_S = 2.0
_STUCK_M = 0.1
_ASTRAY_RAD = math.radians(45.0)
_NEAREST_GOAL_M = 0.3
_AHEAD_M = 0.4


def choose_visited(
    poses: FloatArray, field: CostToGo, count: int, rng: np.random.Generator, *, interval_s: float
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Choose states of a drive.

    Args:
        poses: (T, 3) x, y in metres and yaw in radians, world frame.
        field: The expert's cost to the drive's goal.
        count: How many states; fewer come where the drive has fewer that the expert can label.
        rng: Decides which.
        interval_s: Time between two poses.

    Returns:
        Their numbers (S,), ascending, and their :class:`StateKind` (S,).
    """
    usable = _usable(poses, field)
    chosen: dict[int, StateKind] = {}
    for kind, mask in _troubles(poses, field, usable, round(_STUCK_S / interval_s)).items():
        fitting = np.setdiff1d(np.flatnonzero(mask), list(chosen))
        chosen |= dict.fromkeys(_some(fitting, round(_SHARE * count), rng), kind)
    rest = np.setdiff1d(np.flatnonzero(usable), list(chosen))
    chosen |= dict.fromkeys(_some(rest, count - len(chosen), rng), StateKind.VISITED)
    numbers = np.array(sorted(chosen), dtype=np.int64)
    return numbers, np.array([chosen[int(number)] for number in numbers], dtype=np.uint8)


def _usable(poses: FloatArray, field: CostToGo) -> NDArray[np.bool_]:
    """Return at which poses (T, 3) the expert has a way that is not over yet."""
    places = poses[:, :2]
    free = field.grid.clearance_m(places) > INSCRIBED_M
    far = np.hypot(*(places - field.goal_m).T) > _NEAREST_GOAL_M
    return np.asarray(free & far & field.reachable(places))


def _troubles(
    poses: FloatArray, field: CostToGo, usable: NDArray[np.bool_], stuck_steps: int
) -> dict[StateKind, NDArray[np.bool_]]:
    near = usable & (field.grid.clearance_m(poses[:, :2]) < INSCRIBED_M + NEAR_M)
    stuck = np.zeros(len(poses), dtype=np.bool_)
    moved = np.hypot(*(poses[stuck_steps:, :2] - poses[:-stuck_steps, :2]).T)
    stuck[stuck_steps:] = moved < _STUCK_M
    astray = np.zeros(len(poses), dtype=np.bool_)
    ahead = field.waypoints_batch(poses[usable], count=1, spacing_m=_AHEAD_M)[:, 0]
    astray[usable] = np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) > _ASTRAY_RAD
    return {StateKind.NEAR: near, StateKind.STUCK: stuck & usable, StateKind.ASTRAY: astray}


def _some(numbers: NDArray[np.int64], count: int, rng: np.random.Generator) -> list[int]:
    return [int(number) for number in rng.permutation(numbers)[: max(0, count)]]
