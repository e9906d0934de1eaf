"""From a disparity of unknown scale and shift to places on the floor.

The floor fixes scale and shift (:mod:`revnm_server.floor_fit`). With z the depth of a pixel along the view and
``nearness`` the inverse depth of the floor at it: height over the floor = camera height · (1 − z · nearness), place =
z · ray. The floor's line hides errors of pitch, focal length and camera height from this test of floor or not: they
displace what is seen, but make no obstacles. Imports numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from revnm_server.floor_fit import FloorLine, fit_floor
from revnm_server.floor_view import FloorView
from revnm_server.observation import Image32

_STRIDE = 4  # pixels that the fit skips, both ways
_LEAST_NEARNESS = 1e-3


class Kind(IntEnum):
    """What a pixel shows."""

    UNKNOWN = 0
    FLOOR = 1
    OBSTACLE = 2


@dataclass(frozen=True, slots=True)
class LiftSpec:
    """How floor and obstacle are told apart.

    Attributes:
        tolerance_m: What rises less over the floor is floor, near the camera and with exact depth.
        sigmas: Standard deviations of the height that the tolerance covers.
        most_tolerance_m: Where the tolerance is wider, what looks like floor is unknown.
        farthest_m: Depth along the view beyond which nothing is said.
    """

    tolerance_m: float = 0.04
    sigmas: float = 3.0
    most_tolerance_m: float = 0.35
    farthest_m: float = 16.0


@dataclass(frozen=True, slots=True)
class Lifted:
    """A picture with metric places.

    Attributes:
        kind: (h, w) uint8, a :class:`Kind`.
        x_m: (h, w) float32, floor frame; of floor pixels where the ray meets the floor; meaningless where unknown.
        y_m: (h, w) float32, the same along y.
        height_m: (h, w) float32, over the floor; meaningless where unknown.
        grade: (h, w) float32 in [−1, 1]: −1 surely floor, 1 surely obstacle, 0 at the tolerance or unknown.
        line: The fit; its ``nearness_sigma`` is the noise of the depth.
    """

    kind: NDArray[np.uint8]
    x_m: Image32
    y_m: Image32
    height_m: Image32
    grade: Image32
    line: FloorLine


@dataclass(frozen=True, slots=True)
class NoFloor:
    """A picture that could not be lifted: no map rather than a wrong one.

    Attributes:
        reason: For people.
    """

    reason: str


class FloorLifter:
    """Lifts the pictures of one calibrated camera; each fit starts from the last one."""

    def __init__(self, view: FloorView, spec: LiftSpec | None = None) -> None:
        self.view = view
        self._spec = spec or LiftSpec()
        self._line: FloorLine | None = None
        self._below_horizon = view.nearness > 1.0 / self._spec.farthest_m
        self._floor_depth = 1.0 / np.maximum(view.nearness, np.float32(_LEAST_NEARNESS))
        self._height = np.float32(view.camera.height_m)

    def lift(self, disparity: Image32, usable: NDArray[np.bool_]) -> Lifted | NoFloor:
        """Lift one picture.

        Args:
            disparity: (h, w), larger is nearer, any scale and shift.
            usable: (h, w), where it was measured and is not clipped.
        """
        part = (slice(_STRIDE // 2, None, _STRIDE),) * 2
        sample = self._below_horizon[part] & usable[part]
        nearness = self.view.nearness[part][sample].astype(np.float64)
        line = fit_floor(nearness, disparity[part][sample].astype(np.float64), self._line)
        if isinstance(line, str):
            self._line = None
            return NoFloor(line)
        self._line = line
        return self._place(disparity, usable, line)

    def _place(self, disparity: Image32, usable: NDArray[np.bool_], line: FloorLine) -> Lifted:
        view, spec = self.view, self._spec
        nearness = (disparity - np.float32(line.shift)) * np.float32(1.0 / line.scale)
        in_range = usable & (nearness > 1.0 / spec.farthest_m)
        depth = 1.0 / np.maximum(nearness, np.float32(_LEAST_NEARNESS))
        height = self._height * (1.0 - depth * view.nearness)
        tolerance = self._tolerance_m(line)
        obstacle = in_range & (height > tolerance)
        floor = usable & self._below_horizon & ~obstacle
        floor &= (tolerance < spec.most_tolerance_m) & (height > -2.0 * tolerance)
        depth = np.where(floor, self._floor_depth, depth)
        grade = np.clip(height / tolerance - 1.0, -1.0, 1.0)
        grade *= obstacle | floor
        kind = floor.astype(np.uint8) + np.uint8(Kind.OBSTACLE) * obstacle.astype(np.uint8)
        return Lifted(kind, depth * view.ray_x, depth * view.ray_y, height, grade, line)

    def _tolerance_m(self, line: FloorLine) -> Image32:
        """Return the tolerance (h, w): at the floor, dheight / dnearness = camera height · depth of the floor."""
        noise = np.float32(line.nearness_sigma**2) + np.square(self.view.nearness_sigma)
        sigma = self._height * self._floor_depth * np.sqrt(noise)
        tolerance = np.maximum(np.float32(self._spec.sigmas) * sigma, np.float32(self._spec.tolerance_m))
        # Over the horizon nothing is floor, and every height is more than the camera's.
        return np.where(self.view.nearness > _LEAST_NEARNESS, tolerance, np.float32(self._spec.tolerance_m))
