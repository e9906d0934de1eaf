"""Savitzky-Golay smoothing of a control sequence (doi:10.1021/ac60214a047)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def savitzky_golay(steps: int, *, window: int = 9, order: int = 2) -> NDArray[np.float32]:
    """Return the matrix (T, T) that replaces each value by a polynomial fitted around it.

    Towards both ends the window stays inside the sequence, so that the first value, the one that is sent to
    the robot, is a fit too, not a padded mean.

    Args:
        steps: T, at least ``window``.
        window: Values of a fit.
        order: Degree of the polynomial.
    """
    matrix = np.zeros((steps, steps), dtype=np.float32)
    for row in range(steps):
        first = min(max(row - window // 2, 0), steps - window)
        powers = np.vander(np.arange(window) - (row - first), order + 1, increasing=True)
        matrix[row, first : first + window] = np.linalg.pinv(powers.astype(np.float64))[0]
    return matrix
