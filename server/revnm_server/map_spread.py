"""How far uncertain obstacles spread over the map.

What stands at a cell may stand at another with a standard deviation that the calibration's covariance and the noise of
the depth give. A cell's probability becomes the greatest of its neighbours', each less by the Gaussian of its distance
in its own standard deviations; apart along x and y, so that it costs little. Imports numpy and OpenCV only.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.floor_view import FloorView, place_jacobian, root
from revnm_server.node_grid import NodeGrid
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
        self._weights: list[tuple[list[Image32], int]] = []

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
        reach = max((len(weights) for weights, _ in self._weights), default=0)
        window = _around(probability > 0.0, reach)
        part = probability[window]
        for weights, axis in self._weights:
            part = _dilate(part, [weight[window] for weight in weights], axis)
        spread = probability.copy()
        spread[window] = part
        return spread

    def sigma_m(self, nearness_sigma: float) -> Image32:
        """Return the standard deviations (Ny, Nx, 2) along x and y, metres, unbounded."""
        return np.asarray(np.hypot(self._calibration_m, np.float32(nearness_sigma) * self._per_nearness))

    def _prepare(self, nearness_sigma: float) -> list[tuple[list[Image32], int]]:
        sigma = np.minimum(self.sigma_m(nearness_sigma), np.float32(self._most_m)) / np.float32(self._cell_m)  # cells
        found = []
        for axis, along in ((1, 0), (0, 1)):
            own = np.maximum(sigma[..., along], np.float32(1e-3))
            precision = np.float32(-0.5) / np.square(own)
            farthest = np.float32(SPREAD_SIGMAS) * own
            distances = range(1, math.ceil(farthest.max()))
            weights = [np.exp(np.float32(d * d) * precision) * (d < farthest) for d in distances]
            found.append((weights, axis))
        return found


def _around(filled: NDArray[np.bool_], reach: int) -> tuple[slice, slice]:
    """Return the rows and columns that hold all filled cells, and so many more on each side."""
    held = [np.flatnonzero(filled.any(axis=axis)) for axis in (1, 0)]
    if not len(held[0]):
        return slice(0), slice(0)
    rows, columns = (slice(max(0, int(each[0]) - reach), int(each[-1]) + reach + 1) for each in held)
    return rows, columns


def _dilate(probability: Image32, weights: list[Image32], axis: int) -> Image32:
    """Return the greatest (Ny, Nx) of a cell and its weighted neighbours along an axis; weights are the neighbours'."""
    result = probability.copy()
    source = np.moveaxis(probability, axis, 0)
    target = np.moveaxis(result, axis, 0)
    for distance, weight in enumerate(weights, start=1):
        moved = source * np.moveaxis(weight, axis, 0)
        np.maximum(target[distance:], moved[:-distance], out=target[distance:])
        np.maximum(target[:-distance], moved[distance:], out=target[:-distance])
    return result


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
