"""From a disparity of unknown scale and shift to places on the floor.

The floor fixes scale and shift (:mod:`revnm_server.mapping.floor_fit`). With z the depth of a pixel along the view and
``nearness`` the inverse depth of the floor at it: height over the floor = camera height · (1 − z · nearness), place =
z · ray. The floor's line hides errors of pitch, focal length and camera height from this test of floor or not: they
displace what is seen, but make no obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from revnm_server.mapping.floor_bend import Bend, CosineField, fit_bend
from revnm_server.mapping.floor_fit import FloorLine, fit_floor
from revnm_server.mapping.floor_view import FloorView
from revnm_server.mapping.lift_kernels import Rays, placed, slopes
from revnm_server.observation import Image32
from revnm_server.stage_checks import check_shape

FARTHEST_M = 16.0
"""Depth along the view beyond which nothing is said."""

_STRIDE = 4  # pixels that the fit skips, both ways
_LEAST_NEARNESS = 1e-3
_STEEP_ACROSS = np.float32(1.0)  # steps that may be a ramp, of the floor's nearness from row to row
_STEEP_DOWN = np.float32(2.0)
_NOISE_STEP = 4.0  # standard deviations


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
    """

    tolerance_m: float = 0.04
    sigmas: float = 3.0
    most_tolerance_m: float = 0.35


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
        bend_rms: 1/m, the smooth error of the floor's nearness that was taken off: of the network, or of a calibration
            whose roll or lens is wrong.
    """

    kind: NDArray[np.uint8]
    x_m: Image32
    y_m: Image32
    height_m: Image32
    grade: Image32
    line: FloorLine
    bend_rms: float


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
        self._below_horizon = view.nearness > 1.0 / FARTHEST_M
        self._floor_depth = np.asarray(1.0 / np.maximum(view.nearness, np.float32(_LEAST_NEARNESS)), dtype=np.float32)
        self._height = np.float32(view.camera.height_m)
        self._cosines = CosineField(view.hw)
        first = _STRIDE // 2
        rows, columns = np.meshgrid(*(np.arange(first, size, _STRIDE) for size in view.hw), indexing="ij")
        below = self._below_horizon[rows, columns]
        self._sample = rows[below], columns[below]
        self._sample_nearness = view.nearness[self._sample].astype(np.float64)
        self._fields = self._cosines.at(*self._sample)
        self._floor_step = np.float32(np.abs(np.diff(view.nearness, axis=0)).max())

    def lift(self, disparity: Image32, usable: NDArray[np.bool_]) -> Lifted | NoFloor:
        """Lift one picture.

        Args:
            disparity: (h, w), larger is nearer, any scale and shift.
            usable: (h, w), where it was measured and is not clipped.

        Raises:
            ContractError: One of them is not of the view's size.
        """
        check_shape("disparity", disparity, self.view.hw)
        check_shape("usable", usable, self.view.hw)
        disparity = np.ascontiguousarray(disparity, dtype=np.float32)
        chosen = usable[self._sample]
        nearness, floor = self._sample_nearness[chosen], disparity[self._sample][chosen].astype(np.float64)
        line = fit_floor(nearness, floor, self._line)
        if isinstance(line, str):
            self._line = None
            return NoFloor(line)
        self._line = line
        bend = fit_bend(nearness[::2], floor[::2], self._fields[chosen][::2], line)
        return self._place(disparity, usable, bend)

    def _place(self, disparity: Image32, usable: NDArray[np.bool_], bend: Bend) -> Lifted:
        view, spec, line = self.view, self._spec, bend.line
        straight = disparity - self._cosines.image(bend.weights)
        nearness = (straight - np.float32(line.shift)) * np.float32(1.0 / line.scale)
        noise_step = np.float32(_NOISE_STEP * line.nearness_sigma)
        across, down = (max(steep * self._floor_step, noise_step) for steep in (_STEEP_ACROSS, _STEEP_DOWN))
        usable = usable & ~slopes(nearness, across, down)
        tolerance_m = self._tolerance_m(line)
        rays = Rays(view.nearness, self._floor_depth, tolerance_m, self._below_horizon, view.ray_x, view.ray_y)
        farthest, most_m = np.float32(1.0 / FARTHEST_M), np.float32(spec.most_tolerance_m)
        seen = placed(nearness, usable, rays, self._height, farthest, np.float32(_LEAST_NEARNESS), most_m)
        return Lifted(*seen, line, bend.rms)

    def _tolerance_m(self, line: FloorLine) -> Image32:
        """Return the tolerance (h, w): at the floor, dheight / dnearness = camera height · depth of the floor."""
        noise = np.float32(line.nearness_sigma**2) + np.square(self.view.nearness_sigma)
        sigma = self._height * self._floor_depth * np.sqrt(noise)
        tolerance = np.maximum(np.float32(self._spec.sigmas) * sigma, np.float32(self._spec.tolerance_m))
        # Over the horizon nothing is floor, and every height is more than the camera's.
        return np.where(self.view.nearness > _LEAST_NEARNESS, tolerance, np.float32(self._spec.tolerance_m))
