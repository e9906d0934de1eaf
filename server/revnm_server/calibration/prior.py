"""What is known of a camera before its robots tell more. Imports numpy only."""

from __future__ import annotations

import math

import numpy as np

from revnm_server.calibration.adjustment import Belief
from revnm_server.calibration.keyframes import Keyframe

_KNOCK = np.array([0.02, math.radians(4.0), math.radians(3.0), 0.05, 1e-4])
_DISTORTION_SIGMA = 0.05
_STRAIGHT_SIGMA = 1e-4
_LEAST_FRAMES, _LEAST_SPAN = 12, 0.4


def wide_prior() -> Belief:
    """Return what is known of a camera on a wall before it has seen a robot.

    Horizontal fields of view of about 50° to 125°, pitch 30° ± 15°, roll 0 ± 2°, height 2.7 m, times or by 1.4, no
    distortion.
    """
    mean = np.array([math.log(0.5), math.radians(30.0), 0.0, math.log(2.7), 0.0])
    sigma = np.array([0.35, math.radians(15.0), math.radians(2.0), 0.33, _STRAIGHT_SIGMA])
    return Belief(mean, np.diag(np.square(sigma)))


def loosened(belief: Belief) -> Belief:
    """Return what is still known of a camera after somebody may have knocked against it: the lens, above all."""
    return Belief(belief.mean, belief.covariance + np.diag(np.square(_KNOCK)))


def distorted(prior: Belief, frames: list[Keyframe], size_px: tuple[int, int]) -> Belief:
    """Return the prior, its distortion free where the keyframes are many and lie near to and far from the middle."""
    middle = (np.array(size_px) - 1.0) / 2.0
    radii = np.linalg.norm([frame.pixel - middle for frame in frames], axis=1) / (size_px[0] / 2.0)
    if len(frames) < _LEAST_FRAMES or np.ptp(radii) < _LEAST_SPAN:
        return prior
    covariance = prior.covariance.copy()
    covariance[4, 4] = max(covariance[4, 4], _DISTORTION_SIGMA**2)
    return Belief(prior.mean, covariance)
