"""Calibrations and depth pictures as wrong as real ones are, by name. Imports no PyBullet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.floor_camera import FloorCamera
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.measures.lift_truth import exact_calibration


@dataclass(frozen=True, slots=True)
class CalibrationFault:
    """Sizes of errors; the sign of each is drawn.

    Attributes:
        focal: Relative.
        pitch_rad: Absolute.
        roll_rad: Absolute.
        height: Relative.
        told: Whether the lift is told a covariance of this size; else it believes that the calibration is exact.
    """

    focal: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    height: float = 0.0
    told: bool = True

    def apply(self, camera: Camera, rng: np.random.Generator) -> tuple[FloorCamera, FloatArray | None]:
        """Return the wrong calibration of a camera, and the covariance (5, 5) that is told, if any."""
        exact = exact_calibration(camera)
        errors = np.array([self.focal, self.pitch_rad, self.roll_rad, self.height, 0.0])
        wrong = FloorCamera.from_vector(exact.vector + errors * rng.choice([-1.0, 1.0], errors.size), exact.size_px)
        return wrong, np.diag(np.square(errors)) if self.told and errors.any() else None


@dataclass(frozen=True, slots=True)
class DepthFault:
    """Errors of a disparity, in spans between its 2nd and 98th percentile.

    Attributes:
        bias: Standard deviation of a smooth field (4 × 4 knots), the same in all pictures of a camera.
        blur_px: Standard deviation of the Gaussian that softens edges, pixels of the grid.
        noise: Standard deviation of a pixel's noise, new in every picture.
        pure: Nothing but noise.
    """

    bias: float = 0.0
    blur_px: float = 0.0
    noise: float = 0.0
    pure: bool = False

    def field(self, hw: tuple[int, int], rng: np.random.Generator) -> Image32:
        """Draw the smooth field (h, w)."""
        knots = rng.normal(0.0, self.bias, (4, 4)).astype(np.float32)
        return np.asarray(cv2.resize(knots, hw[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float32)

    def apply(self, disparity: Image32, field: Image32, rng: np.random.Generator) -> Image32:
        """Return a wrong disparity (h, w), of a scale and shift of its own."""
        low, high = np.percentile(disparity, (2.0, 98.0))
        wrong = (disparity - low) / (high - low) + field
        if self.blur_px > 0.0:
            wrong = cv2.GaussianBlur(wrong, (0, 0), self.blur_px)
        wrong = wrong + rng.normal(0.0, max(self.noise, 1e-12), wrong.shape)
        if self.pure:
            wrong = rng.random(wrong.shape)
        return np.asarray(rng.uniform(0.7, 1.4) * wrong + rng.uniform(-0.1, 0.1), dtype=np.float32)


NETWORK = "network"
"""The depth of the shipped network in rendered pictures; it errs by itself."""

_DEGREE = math.radians(1.0)
CALIBRATIONS: Mapping[str, CalibrationFault] = MappingProxyType(
    {
        "exact": CalibrationFault(),
        "focal_height_3pct": CalibrationFault(focal=0.03, height=0.03),
        "pitch_1deg": CalibrationFault(pitch_rad=_DEGREE),
        "roll_1deg": CalibrationFault(roll_rad=_DEGREE),
        "all": CalibrationFault(0.03, _DEGREE, 0.5 * _DEGREE, 0.03),
        "all_untold": CalibrationFault(0.03, _DEGREE, 0.5 * _DEGREE, 0.03, told=False),
    }
)
DEPTHS: Mapping[str, DepthFault] = MappingProxyType(
    {
        "exact": DepthFault(),
        "blur": DepthFault(blur_px=1.0),
        "mild": DepthFault(bias=0.01, blur_px=0.7, noise=0.005),
        "strong": DepthFault(bias=0.03, blur_px=1.5, noise=0.01),
        "noise_only": DepthFault(pure=True),
        NETWORK: DepthFault(),
    }
)
