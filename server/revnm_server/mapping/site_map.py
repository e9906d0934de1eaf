"""The map of one camera's view: what its pictures show and the scans have met, as the calibration has it now."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import RobotSighting
from revnm_server.mapping.disparity_memory import DisparityMemory
from revnm_server.mapping.floor_beliefs import FloorBeliefs
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import Body, FloorMapper, MapSpec
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, Lifted, NoFloor
from revnm_server.mapping.robot_mask import robot_mask, tag_mask
from revnm_server.mapping.scan_memory import ScanMemory
from revnm_server.observation import Image32

_SHIFT = 0.02  # of its distance: a place that moves more asks for a new map
_SURER = 0.7  # of its spread: a calibration that is so much surer, too
_LONGEST_WITHOUT_NS = 2_000_000_000
_NS_PER_S = 1e9


class Reframed(NamedTuple):
    """The map's frame has changed.

    Attributes:
        before: The calibration of the former frame; None where there was none, or nothing of it holds any more.
        now: That of the new one.
    """

    before: FloorCamera | None
    now: FloorCamera

    def carry(self, points_m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Take points (..., 2) of the former frame into the new one; tell for which of them (...,) that is known."""
        if self.before is None:
            return points_m, np.zeros(points_m.shape[:-1], dtype=np.bool_)
        return self.before.carry(points_m, self.now)


class SiteMap:
    """The map in the camera's floor frame."""

    def __init__(
        self,
        size_px: tuple[int, int],
        disparity_hw: tuple[int, int],
        spec: MapSpec | None = None,
        *,
        scans: bool = True,
    ) -> None:
        """Begin with nothing.

        :attr:`reason` says why pictures do not enter the map, empty where they do; :attr:`lifted` is the last one that
        did.

        Args:
            size_px: Width and height of the camera's picture.
            disparity_hw: Height and width of its disparity.
            spec: Size of the map and weight of its evidence.
            scans: Whether scans go into the map.
        """
        self.size_px = size_px
        self.reason = "no calibration yet"
        self.lifted: Lifted | None = None
        self._hw, self._spec = disparity_hw, spec or MapSpec()
        self._memory = DisparityMemory(disparity_hw)
        self._scans = ScanMemory(self._spec) if scans else None
        self._camera: FloorCamera | None = None
        self._spread_m = math.inf
        self._restarts = 0
        self._taken: CalibrationState | None = None
        self._seen: FloorGrid | None = None
        self._seen_ns = 0
        self._beliefs = FloorBeliefs(self._spec)

    def recalibrate(self, state: CalibrationState) -> Reframed | None:
        """Take a calibration; return what became of the map's frame if it changed: scans must be placed again then.

        A calibration that began anew, because something has jumped, forgets what the pictures showed before.
        """
        assert state.camera is not None
        if state is self._taken:  # it is the same object until something is learnt
            return None
        self._taken = state
        jumped = state.restarts != self._restarts
        surer = state.spread_2_m < _SURER * self._spread_m
        if self._camera is not None and not jumped and not surer and self._shift(state.camera) < _SHIFT:
            return None
        before = None if jumped else self._camera
        if before is not None:
            self._beliefs.carry(before, state.camera)
        self._camera, self._spread_m, self._restarts = state.camera, state.spread_2_m, state.restarts
        self._view = floor_view(state.camera, self._hw, state.covariance)
        self._lifter, self._mapper = FloorLifter(self._view), FloorMapper(self._view, self._spec)
        if self._scans is not None:
            self._scans.forget()
        if jumped:
            self._memory.forget()
            self._beliefs.forget()
            self._seen = None
        return Reframed(before, state.camera)

    def hear_scan(self, scan: Scan, floor_from_robot: Pose2, *, times: int = 1) -> None:
        """Take a scan that was made at a place, and stands for so many."""
        if self._scans is not None:
            self._scans.update(scan, floor_from_robot, scan.stamp_ns / _NS_PER_S, times=times)

    def forget_scans(self) -> None:
        """Forget what scans have met, as when they were made elsewhere."""
        if self._scans is not None:
            self._scans.forget()

    def see(
        self, stamp_ns: int, disparity: Image32, bodies: tuple[Body, ...], unplaced: Sequence[RobotSighting]
    ) -> None:
        """Take a picture.

        Args:
            stamp_ns: Its capture time.
            disparity: (h, w), up to scale and shift.
            bodies: Robots whose places are known.
            unplaced: The last sightings of the others.
        """
        robots = tag_mask(unplaced, self.size_px, self._hw)
        if self._camera is not None:
            robots |= robot_mask(self._view, bodies)
        remembered = self._memory.update(disparity, robots, stamp_ns / _NS_PER_S)
        if self._camera is None:
            return
        lifted = self._lifter.lift(remembered.disparity, remembered.usable)
        if isinstance(lifted, NoFloor):
            self.reason = lifted.reason
            return
        self.reason, self.lifted = "", lifted
        self._seen, self._seen_ns = self._mapper.draw(lifted, remembered.age_s, bodies), stamp_ns

    def believe(self, windows: Sequence[tuple[Image32, Pose2]], stamp_ns: int) -> None:
        """Take what a policy believes to stand around robots, (side, side) probabilities and poses, as of a time."""
        self._beliefs.take(windows, stamp_ns)

    def believed_grid(self, grid: FloorGrid, stamp_ns: int) -> FloorGrid:
        """Return a map with the beliefs in it, as of a time."""
        return self._beliefs.into(grid, None if self._scans is None else self._scans.met, stamp_ns)

    def scans_alone(self) -> Image32 | None:
        """Return the probability (Ny, Nx) of obstacles by the scans alone; None where they do not go into the map."""
        return None if self._scans is None else self._scans.probability

    def grid(self, stamp_ns: int) -> FloorGrid | None:
        """Return the map as of a time.

        While no picture of the last seconds could be lifted, and :attr:`reason` says why, it holds the scans alone;
        without scans there is None.
        """
        if self._camera is None:
            return None
        seen = self._seen if stamp_ns - self._seen_ns <= _LONGEST_WITHOUT_NS else None
        if self._scans is None:
            return seen
        return self._scans.fuse(seen or self._spec.unknown(), stamp_ns / _NS_PER_S)

    def _shift(self, camera: FloorCamera) -> float:
        """Return how far the places of some pixels move with a new calibration, as a share of their distance."""
        assert self._camera is not None
        width, height = self.size_px
        pixels = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 3) * width, np.linspace(0.4, 1.0, 4) * height), axis=-1)
        before, valid = self._camera.on_plane(pixels)
        after, still = camera.on_plane(pixels)
        far = np.linalg.norm(before, axis=-1)
        known = valid & still & (far < 8.0)
        moved: FloatArray = np.linalg.norm(after - before, axis=-1)[known] / np.maximum(far[known], 1.0)
        return float(moved.max(initial=0.0))
