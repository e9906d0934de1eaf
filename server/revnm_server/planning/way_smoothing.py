"""From the graph's staircase to a way at any angle: the cheapest chain of straight legs, then its corners rounded.

Imports numpy and scipy only.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from revnm_client.geometry import FloatArray
from revnm_server.planning.travel_cost import TravelCost
from revnm_server.planning.way import SPACING_M, evenly

_NODES = 56
_SAMPLES = 48  # of a leg
_PER_LEG = 1e-3  # of two equal chains the one of fewer legs
_ROUND_M = 0.15
_ROUND_COST = 1.01


def smooth(rough_m: FloatArray, cost: TravelCost) -> FloatArray:
    """Return a smooth way (P, 2), metres, evenly spaced, with the ends of a rough one (Q, 2) and cheaper."""
    fine = evenly(rough_m, 0.5 * SPACING_M)
    picked = np.unique(np.linspace(0, len(fine) - 1, min(_NODES, len(rough_m) + 2)).round().astype(np.int64))
    legs = evenly(_cheapest_legs(fine[picked], cost))
    rounded = evenly(_rounded(legs))
    return rounded if cost.of_way(rounded) <= _ROUND_COST * cost.of_way(legs) else legs


def _cheapest_legs(nodes_m: FloatArray, cost: TravelCost) -> FloatArray:
    """Return those of the nodes (N, 2), in their order, with both ends, whose chain of straight legs is cheapest."""
    begins, ends = np.triu_indices(len(nodes_m), 1)
    fractions = (np.arange(_SAMPLES, dtype=np.float32) + np.float32(0.5)) / np.float32(_SAMPLES)
    rows, columns = (
        axis[begins, None] + fractions * (axis[ends] - axis[begins])[:, None]  # (L, S)
        for axis in cost.grid.cells(nodes_m).astype(np.float32).T
    )
    lengths = np.hypot(*(nodes_m[ends] - nodes_m[begins]).T)
    leg = np.full((len(nodes_m), len(nodes_m)), np.inf)
    leg[begins, ends] = cost.at_cells(rows, columns).mean(axis=1) * lengths + _PER_LEG
    least = np.zeros(len(nodes_m))
    before = np.zeros(len(nodes_m), dtype=np.int64)
    for k in range(1, len(nodes_m)):
        totals = least[:k] + leg[:k, k]
        before[k] = np.argmin(totals)
        least[k] = totals[before[k]]
    chain = [len(nodes_m) - 1]
    while chain[-1] > 0:
        chain.append(int(before[chain[-1]]))
    return nodes_m[chain[::-1]]


def _rounded(way_m: FloatArray) -> FloatArray:
    """Return the way (P, 2) with rounded corners; mirroring about its ends keeps them where they are."""
    sigma = _ROUND_M / SPACING_M
    margin = min(int(np.ceil(4.0 * sigma)), len(way_m) - 1)
    padded = np.pad(way_m, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, sigma, axis=0, mode="nearest")[margin : margin + len(way_m)])
