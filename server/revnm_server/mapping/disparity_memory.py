"""The static camera's memory: what the picture shows where nothing moves.

Works on disparities of unknown scale and shift, so it needs no calibration.

The rule. A pixel that agrees with its background is averaged into it. One that does not agree is shown as it is, at
once; if it then stays the same for ``settle_s``, it becomes the background. So a thing that appears is there with the
first picture, and one that leaves is gone with the first picture that shows what is behind it, and from the memory
behind the robot after ``settle_s``. Robots are never learnt: pixels on them come from the memory, and those never
seen without a robot are unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.mapping.memory_kernels import Background, learnt
from revnm_server.observation import Image32
from revnm_server.order_statistics import median, quantiles
from revnm_server.stage_checks import check_shape

_STRIDE = 6
_ROUNDS = 5
_LEAST_PIXELS = 40
_CLIPPED_SHARE = 0.015  # more than a row
_BoolImage = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class MemorySpec:
    """Times and tolerances.

    Attributes:
        settle_s: What stays so long becomes background.
        average_s: Time constant of the average over pictures.
        tolerance: Difference from the background, in spans of the disparity, that is always noise.
        sigmas: Standard deviations of a picture's difference from the background that are noise.
        least_share: Of the pixels must agree with the background; else the camera or the scene is another one.
        lost_s: After so long without agreement everything is forgotten.
    """

    settle_s: float = 0.6
    average_s: float = 2.0
    tolerance: float = 0.004
    sigmas: float = 4.0
    least_share: float = 0.5
    lost_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Remembered:
    """A picture without robots.

    Attributes:
        disparity: (h, w) float32, in the units of the first picture; 0 where never seen.
        usable: (h, w), where it was ever seen without a robot and is not clipped.
        age_s: (h, w) float32, time since the pixel was truly seen; inf where it never was.
        moving: (h, w), where it differs from the background.
        aligned: Whether the picture fits the memory; if not, this is the picture alone, in its own units.
    """

    disparity: Image32
    usable: _BoolImage
    age_s: Image32
    moving: _BoolImage
    aligned: bool


class DisparityMemory:
    """The memory of one camera."""

    def __init__(self, hw: tuple[int, int], spec: MemorySpec | None = None) -> None:
        """Start with nothing.

        Args:
            hw: Height and width of the disparities.
            spec: Times and tolerances.
        """
        self._hw = hw
        self._spec = spec or MemorySpec()
        self.forget()

    def forget(self) -> None:
        """Forget everything, as after the camera was moved."""
        self._memory = Background(
            disparity=np.zeros(self._hw, dtype=np.float32),
            pictures=np.zeros(self._hw, dtype=np.float32),
            candidate=np.zeros(self._hw, dtype=np.float32),
            since_s=np.full(self._hw, math.inf),
            seen_s=np.full(self._hw, -math.inf),
            clipped=np.zeros(self._hw, dtype=np.bool_),
        )
        self._stamp_s = -math.inf
        self._lost_since_s = math.inf

    def update(self, disparity: Image32, robots: _BoolImage, stamp_s: float) -> Remembered:
        """Take the next picture.

        Args:
            disparity: (h, w), larger is nearer, of any scale and shift, another in every picture.
            robots: (h, w), where robots are.
            stamp_s: Capture time; must not go back.

        Raises:
            ContractError: One of them is of another size.
        """
        check_shape("disparity", disparity, self._hw)
        check_shape("robots", robots, self._hw)
        disparity = np.ascontiguousarray(disparity, dtype=np.float32)
        seen, cut = ~robots, clipped(disparity)
        fit = self._align(disparity, seen & ~cut)
        if fit is None:
            return self._lost(disparity, seen, cut, stamp_s)
        self._lost_since_s = math.inf
        scale, shift, tolerance = fit
        aligned = (disparity - np.float32(shift)) * np.float32(1.0 / scale)
        dt_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        least_gain = min(1.0, dt_s / self._spec.average_s) if math.isfinite(dt_s) else 1.0
        shown, usable, age, moving = learnt(
            self._memory, aligned, seen, cut, tolerance, least_gain, self._spec.settle_s, stamp_s
        )
        return Remembered(shown, usable, age, moving, True)

    def _align(self, disparity: Image32, good: _BoolImage) -> tuple[float, float, float] | None:
        """Return scale, shift and tolerance of a picture against the background, or None if they do not fit."""
        part = (slice(_STRIDE // 2, None, _STRIDE),) * 2
        memory = self._memory
        sample = good[part] & (memory.pictures[part] > 0.0) & ~memory.clipped[part]
        if not memory.pictures.any():
            span = float(np.ptp(quantiles(disparity[good], (0.02, 0.98)))) if good.any() else 0.0
            return 1.0, 0.0, self._spec.tolerance * span
        if sample.sum() < _LEAST_PIXELS:
            return None
        known, new = (image[part][sample].astype(np.float64) for image in (memory.disparity, disparity))
        scale, shift, sigma = _affine(known, new)
        span = float(np.ptp(quantiles(known, (0.02, 0.98))))
        tolerance = max(self._spec.sigmas * sigma, self._spec.tolerance * span)
        if not scale > 0.0 or tolerance > 0.5 * span:
            return None
        agree = np.abs((new - shift) / scale - known) < tolerance
        return (scale, shift, tolerance) if agree.mean() >= self._spec.least_share else None

    def _lost(self, disparity: Image32, seen: _BoolImage, cut: _BoolImage, stamp_s: float) -> Remembered:
        self._lost_since_s = min(self._lost_since_s, stamp_s)
        if stamp_s - self._lost_since_s >= self._spec.lost_s:
            self.forget()
            return self.update(disparity, ~seen, stamp_s)
        age = np.where(seen, 0.0, math.inf).astype(np.float32)
        return Remembered(np.where(seen, disparity, np.float32(0.0)), seen & ~cut, age, seen.copy(), False)


def _affine(known: FloatArray, new: FloatArray) -> tuple[float, float, float]:
    """Fit new = scale · known + shift robustly (Tukey's biweight); return scale, shift and sigma in units of known."""
    (low, middle, high), (new_low, new_middle, new_high) = (quantiles(each, (0.2, 0.5, 0.8)) for each in (known, new))
    scale = float((new_high - new_low) / np.maximum(high - low, 1e-12))
    shift = float(new_middle - scale * middle)
    sigma = math.inf
    for _ in range(_ROUNDS):
        rest = new - scale * known - shift
        sigma = max(1.4826 * median(np.abs(rest)), 1e-9)
        weight = np.square(np.maximum(1.0 - np.square(rest / (4.7 * sigma)), 0.0))
        total = max(float(weight.sum()), 1e-12)
        mean_known, mean_new = (weight @ known) / total, (weight @ new) / total
        spread = float(weight @ np.square(known - mean_known))
        scale = float(weight @ ((known - mean_known) * (new - mean_new)) / max(spread, 1e-12))
        shift = float(mean_new - scale * mean_known)
    return scale, shift, sigma / max(abs(scale), 1e-12)


def clipped(disparity: Image32) -> NDArray[np.bool_]:
    """Return where (h, w) a disparity sits at its own least or greatest value, if so many pixels do that it is cut."""
    low, high = disparity.min(), disparity.max()
    found = np.zeros(disparity.shape, dtype=np.bool_)
    for end in (low, high):
        at_end = disparity == end
        if at_end.sum() > _CLIPPED_SHARE * disparity.size:
            found |= at_end
    return found
