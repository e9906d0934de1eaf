"""Medians and quantiles of a few thousand numbers, without the checks that cost NumPy's own most of their time.

Inputs must be finite and not empty; nothing is checked. Imports numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray


def median(values: FloatArray) -> float:
    """Return the median of numbers (M,)."""
    half = len(values) // 2
    parted = np.partition(values, half)
    upper = float(parted[half])
    return upper if len(values) % 2 else 0.5 * (float(parted[:half].max()) + upper)


def quantiles(values: NDArray[np.floating], shares: Sequence[float]) -> FloatArray:
    """Return the quantiles (Q,) of numbers (M,) at shares in [0, 1], linear between neighbours."""
    place = np.asarray(shares) * (len(values) - 1)
    return np.asarray(np.interp(place, np.arange(len(values)), np.sort(values)))
