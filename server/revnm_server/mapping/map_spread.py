"""How far uncertain obstacles spread over the map.

What stands at a cell may stand at another with a standard deviation that the calibration's covariance and the noise of
the depth give. A cell's probability becomes the greatest of its neighbours', each less by the Gaussian of its distance
in its own standard deviations; apart along x and y, so that it costs little.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.mapping.draw_kernels import spread_along
from revnm_server.mapping.floor_view import FloorView, place_jacobian, root
from revnm_server.mapping.node_grid import NodeGrid
from revnm_server.observation import Image32

SPREAD_SIGMAS = 2.0
"""What is so far or farther is let go."""

_HOLD = 1.5  # the depth's noise may change by this factor before weights are computed anew


class MapSpread:
    """Spreads obstacles over the grid of one calibrated camera."""

    def __init__(self, view: FloorView, middles_m: FloatArray, cell_m: float, most_m: float) -> None:
        """Prepare.

        Args:
            view: The calibrated camera.
            middles_m: (Ny, Nx, 2) of the cells.
            cell_m: Side of a cell.
            most_m: Bound of the standard deviation.
        """
        self._cell_m = cell_m
        self._most_m = most_m
        self._calibration_m = _calibration_sigma(view, middles_m)
        self._per_nearness = _per_nearness(view, middles_m)
        self._prepared_for = 0.0
        self._weights: dict[int, NDArray[np.float32]] = {}

    def spread(self, probability: Image32, nearness_sigma: float) -> Image32:
        """Return the spread probabilities (Ny, Nx).

        Args:
            probability: (Ny, Nx) float32, that something stands there.
            nearness_sigma: Noise of the depth, 1/m.
        """
        noise = max(nearness_sigma, 1e-6)
        if not 1.0 / _HOLD <= noise / max(self._prepared_for, 1e-9) <= _HOLD:
            self._prepared_for = noise
            self._weights = self._prepare(noise)
        for axis, weights in self._weights.items():
            probability = spread_along(probability, weights, axis == 0)
        return probability

    def sigma_m(self, nearness_sigma: float) -> Image32:
        """Return the standard deviations (Ny, Nx, 2) along x and y, metres, unbounded."""
        return np.asarray(np.hypot(self._calibration_m, np.float32(nearness_sigma) * self._per_nearness))

    def _prepare(self, nearness_sigma: float) -> dict[int, NDArray[np.float32]]:
        """Return by axis what a cell gives to those 1 … D cells along it, (D, Ny, Nx)."""
        sigma = np.minimum(self.sigma_m(nearness_sigma), np.float32(self._most_m)) / np.float32(self._cell_m)  # cells
        found = {}
        for axis, along in ((1, 0), (0, 1)):
            own = np.maximum(sigma[..., along], np.float32(1e-3))
            precision = np.float32(-0.5) / np.square(own)
            farthest = np.float32(SPREAD_SIGMAS) * own
            distances = np.arange(1, math.ceil(farthest.max()), dtype=np.float32)[:, None, None]
            found[axis] = np.exp(np.square(distances) * precision) * (distances < farthest)
        return found


def _calibration_sigma(view: FloorView, middles_m: FloatArray) -> Image32:
    """Return the standard deviations (Ny, Nx, 2) of what stands at the cells, from the calibration's covariance."""
    if not view.covariance.any():
        return np.zeros(middles_m.shape, dtype=np.float32)
    grid = NodeGrid((middles_m.shape[0], middles_m.shape[1]))
    places = middles_m[grid.nodes]
    jacobian = place_jacobian(view.camera, places.reshape(-1, 2))  # (M, 2, 5)
    sigma = np.sqrt(np.square(jacobian @ root(view.covariance)).sum(axis=-1)).reshape(places.shape)
    return grid.filled(np.nan_to_num(sigma, nan=1e3, posinf=1e3))


def _per_nearness(view: FloorView, middles_m: FloatArray) -> Image32:
    """Return how far places (Ny, Nx, 2) at the cells move, per axis, if their nearness changes, metres per 1/m.

    z = 1 / nearness, so dz = z² · dnearness, and a place moves in proportion to its depth.
    """
    grid = NodeGrid((middles_m.shape[0], middles_m.shape[1]))
    places = middles_m[grid.nodes]
    _, depth = view.camera.project(np.concatenate([places, np.zeros((*places.shape[:2], 1))], axis=-1))
    return np.asarray(np.abs(middles_m).astype(np.float32) * np.maximum(grid.filled(depth), 0.0)[..., None])
