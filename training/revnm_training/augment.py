"""Makes exact disparity look like the output of a monocular depth network.

Such a network gives disparity up to scale and shift, bends it, blurs edges, tilts large areas and trembles from frame
to frame. Sources for the kinds and sizes of error: parkour (ZiwenZhuang/parkour), viplanner, Depth Transfer; measured
again whenever a depth network is exchanged. Imports numpy and OpenCV only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_server.observation import Image32


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How strong the errors are; numbers without a unit are fractions of the normalised disparity's range.

    Attributes:
        clean: Probability of a sample without error of disparity.
        gamma_log: Standard deviation of the logarithm of the bending exponent.
        bias: Standard deviation of a smooth field of 4 × 4 knots.
        blur_px: Largest standard deviation of the blur, pixels of a picture 256 wide.
        flicker: Standard deviation of each frame's own scale and shift.
        noise: Standard deviation of each pixel.
        pixel: Standard deviation of the robot's place, picture widths (2 pixels of 640).
        heading_rad: Standard deviation of the robot's heading in the picture.
    """

    clean: float = 0.15
    gamma_log: float = 0.12
    bias: float = 0.04
    blur_px: float = 2.0
    flicker: float = 0.02
    noise: float = 0.008
    pixel: float = 2.0 / 640.0
    heading_rad: float = math.radians(4.0)


@dataclass(frozen=True, slots=True)
class DisparityError:
    """The error that the frames of one sample share: apply it to disparity scaled to about [0, 1]."""

    gamma: float
    bias: NDArray[np.float32]
    blur_px: float
    flicker: float
    noise: float

    def apply(self, disparity: Image32, rng: np.random.Generator) -> Image32:
        """Return the disturbed disparity (h, w); its scale and shift are again meaningless."""
        height, width = disparity.shape
        bent: Image32 = np.asarray(cv2.pow(np.clip(disparity, 0.0, 2.0), self.gamma), dtype=np.float32)
        bent *= np.float32(1.0 + self.flicker * rng.standard_normal())
        bent += cv2.resize(self.bias, (width, height), interpolation=cv2.INTER_CUBIC)
        bent += np.float32(self.flicker * rng.standard_normal())
        sigma = self.blur_px * width / 256.0
        if sigma > 0.3:
            bent = np.asarray(cv2.GaussianBlur(bent, (0, 0), sigma), dtype=np.float32)
        bent += np.float32(self.noise) * rng.standard_normal((height, width), dtype=np.float32)
        return bent


def draw_error(disturbance: Disturbance, rng: np.random.Generator) -> DisparityError | None:
    """Draw the error of one sample; None leaves it exact."""
    if rng.random() < disturbance.clean:
        return None
    return DisparityError(
        gamma=math.exp(disturbance.gamma_log * rng.standard_normal()),
        bias=(disturbance.bias * rng.standard_normal((4, 4))).astype(np.float32),
        blur_px=disturbance.blur_px * rng.random(),
        flicker=disturbance.flicker,
        noise=disturbance.noise * 2.0 * rng.random(),
    )
