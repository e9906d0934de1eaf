"""How a network's depth bends: the smooth part of the floor's disparity that no line explains.

Depth networks err by whole regions of the picture more than by pixels, and roll and lens errors of a calibration look
the same. Where floor is seen the error is seen, and it is taken off floor and obstacles alike; where none is seen it is
believed to be small. Low cosines over the picture, ridge regression, reweighted as the line is. Imports numpy only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.mapping.floor_fit import FloorLine
from revnm_server.observation import Image32
from revnm_server.order_statistics import median

_ORDERS = 4
_ROUNDS = 5
_SIZE = 0.02  # standard deviation of a first-order cosine's weight that is believed before, spans of the floor
_INDEPENDENT = 0.2  # neighbouring pixels err alike: so much of each counts


class Bend(NamedTuple):
    """A smooth error of the disparity.

    Attributes:
        weights: (4, 4), of cosines down and across the picture; (0, 0) is 0.
        line: The line beside it.
        rms: Of the error over the floor, 1/m; large where the calibration's roll or lens is wrong, or the network.
    """

    weights: FloatArray
    line: FloorLine
    rms: float


class CosineField:
    """Smooth fields over a grid of pixels."""

    def __init__(self, hw: tuple[int, int]) -> None:
        self._down, self._across = (_cosines(size) for size in hw)  # (h, 4), (w, 4)

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> FloatArray:
        """Return the fields (M, 15), without the constant one, at pixels (M,)."""
        products = self._down[rows][:, :, None] * self._across[columns][:, None, :]
        return np.asarray(products.reshape(len(rows), -1)[:, 1:])

    def image(self, weights: FloatArray) -> Image32:
        """Return the sum (h, w) of the weighted fields."""
        return np.asarray(self._down @ weights @ self._across.T, dtype=np.float32)


def fit_bend(nearness: FloatArray, disparity: FloatArray, fields: FloatArray, line: FloorLine) -> Bend:
    """Fit line and bend together.

    Args:
        nearness: (M,), 1/m, of the floor at pixels below the horizon.
        disparity: (M,), at the same pixels.
        fields: (M, 15), of :meth:`CosineField.at`, at the same pixels.
        line: Where to start.
    """
    design = np.column_stack([nearness, np.ones_like(nearness), fields])
    solution = np.zeros(design.shape[1])
    solution[:2] = line.scale, line.shift
    prior = _prior(line.scale * float(np.ptp(nearness)))
    sigma, rest = line.sigma, disparity - line.scale * nearness - line.shift
    for _ in range(_ROUNDS):
        weight = np.square(np.maximum(1.0 - np.square(rest / (3.0 * sigma)), 0.0)) * (_INDEPENDENT / sigma**2)
        weighted = design * weight[:, None]
        solution = np.linalg.solve(weighted.T @ design + prior, weighted.T @ disparity)
        rest = disparity - design @ solution
        core = np.abs(rest[np.abs(rest) < 3.0 * sigma])
        sigma = max(1.4826 * median(core) if len(core) else sigma, 0.05 * line.sigma)
    if not solution[0] > 0.5 * line.scale:
        return Bend(np.zeros((_ORDERS, _ORDERS)), line, 0.0)
    on = np.abs(rest) < 3.0 * sigma
    rms = float(np.sqrt(np.mean(np.square(fields[on] @ solution[2:])))) / float(solution[0])
    bent = FloorLine(float(solution[0]), float(solution[1]), sigma, float(on.mean()))
    return Bend(np.concatenate([[0.0], solution[2:]]).reshape(_ORDERS, _ORDERS), bent, rms)


def _cosines(size: int) -> FloatArray:
    return np.cos(np.pi * np.arange(_ORDERS) * (np.arange(size)[:, None] + 0.5) / size)


def _prior(span: float) -> FloatArray:
    """Return the inverse covariance (17, 17) that is believed before: none of the line, small cosines."""
    order = np.maximum(np.arange(_ORDERS)[:, None], np.arange(_ORDERS)).ravel()[1:]
    sizes = _SIZE * max(span, 1e-9) / order
    return np.diag(np.concatenate([[1e-12, 1e-12], 1.0 / np.square(sizes)]))
