"""Ego depth as a planner reads it: how far is it free in each of 16 directions? Imports numpy only.

The ego camera is level and ``ego_height_m`` over the floor, so the depth of bare floor is known at every pixel: what
is clearly nearer stands on it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32, ObservationSpec

SECTORS = 16
NEAR_M = 0.6
FREE_M = 1.0
# A thing of height a shows over its top the floor behind it, at depth d / (1 − a / h): at one fifth, what is lower
# than a fifth of the camera's height (5 cm) counts as floor, and so does an imagined floor that is wrong by less.
_NEARER_SHARE = 0.2
# In the lowest rows a fifth is less than a network's accuracy. Nothing is lost: what stands there reaches up into
# rows where the floor is far.
_NEARER_M = 0.1
# The robot drives under what begins above 0.40 m (revnm_sim.occupancy). The row over the horizon shows things at the
# end of the range at up to 0.57 m, and must count.
_UNDERPASS_M = 0.6


def metres(ego: Image32, spec: ObservationSpec) -> FloatArray:
    """Map ego depth in [−1, 1], any shape, to metres, 0 to ``ego_range_m``."""
    return np.asarray((ego.astype(np.float64) + 1.0) / 2.0 * spec.ego_range_m)


def sector_distances(depth_m: FloatArray, spec: ObservationSpec) -> FloatArray:
    """Return how far it is to the nearest obstacle in each sector.

    A pixel shows an obstacle if its depth is less than that of the bare floor there, or than ``ego_range_m`` where
    that is nearer, by a fifth and by 0.1 m; above the horizon, if it is less than ``ego_range_m`` and what it shows is
    at most 0.6 m high: the robot drives under racks. A column of pixels belongs to the sector of its middle.

    Args:
        depth_m: (M, h, w) along the optical axis, metres; h and w are ``ego_px``.
        spec: The ego camera.

    Returns:
        (M, 16) metres over the floor, clipped at ``ego_range_m``, which also stands for no obstacle. The sectors have
        equal angles and span the field of view; the leftmost is the first.
    """
    slopes, sector = _columns(spec)
    obstacle = depth_m < _threshold_m(spec)[:, None]
    obstacle &= spec.ego_height_m - depth_m * _slopes(spec)[:, None] <= _UNDERPASS_M
    reach = np.where(obstacle, depth_m * np.hypot(1.0, slopes), spec.ego_range_m)
    nearest = np.minimum(reach.min(axis=1), spec.ego_range_m)  # (M, w)
    distances = np.full((len(depth_m), SECTORS), spec.ego_range_m)
    for column, owner in enumerate(sector):
        distances[:, owner] = np.minimum(distances[:, owner], nearest[:, column])
    return distances


def _slopes(spec: ObservationSpec) -> FloatArray:
    """Return the offset of pixel middles from the optical axis at depth 1, (ego_px,), right or down."""
    focal_px = spec.ego_px / 2.0 / math.tan(spec.ego_hfov_rad / 2.0)
    return np.asarray((np.arange(spec.ego_px) - (spec.ego_px - 1) / 2.0) / focal_px)


def _columns(spec: ObservationSpec) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return each column's slope and sector, (ego_px,)."""
    slopes = _slopes(spec)
    share = np.arctan(slopes) / spec.ego_hfov_rad + 0.5
    return slopes, np.clip(np.floor(share * SECTORS), 0, SECTORS - 1).astype(np.int64)


def _threshold_m(spec: ObservationSpec) -> FloatArray:
    """Return the depth under which a pixel shows an obstacle, by row, (ego_px,)."""
    down = _slopes(spec)
    below = down > 0.0
    floor = np.minimum(spec.ego_height_m / np.where(below, down, 1.0), spec.ego_range_m)
    clearly = floor - np.maximum(_NEARER_SHARE * floor, _NEARER_M)
    return np.where(below, clearly, spec.ego_range_m)
