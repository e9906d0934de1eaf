"""How wrong a monocular depth network is, after its scale and shift were fitted. Imports numpy only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32

_FARTHEST_M = 20.0
_DELTA = 1.25


class DepthErrors(NamedTuple):
    """Errors of one picture.

    Attributes:
        abs_rel: Mean of |d − d*| / d*, with d the fitted and d* the true depth.
        delta1: Share of the pixels with max(d / d*, d* / d) < 1.25.
    """

    abs_rel: float
    delta1: float


def depth_errors(predicted: Image32 | FloatArray, true: Image32 | FloatArray) -> DepthErrors:
    """Fit scale and shift to the disparity by least squares, and compare depths.

    Source: Ranftl et al., 2022, doi:10.1109/TPAMI.2020.3019967 (the fit); Eigen et al., 2014, arXiv:1406.2283.

    Args:
        predicted: (h, w) disparity up to scale and shift.
        true: (h, w) disparity, 1/m; what is farther than 20 m is left out.
    """
    seen = true > 1.0 / _FARTHEST_M
    guess, target = predicted[seen].astype(np.float64), true[seen].astype(np.float64)
    design = np.column_stack([guess, np.ones_like(guess)])
    scale_shift, *_ = np.linalg.lstsq(design, target, rcond=None)
    fitted = np.maximum(design @ scale_shift, 1.0 / _FARTHEST_M)
    ratio = target / fitted  # d / d*
    return DepthErrors(float(np.mean(np.abs(ratio - 1.0))), float(np.mean(np.maximum(ratio, 1.0 / ratio) < _DELTA)))
