"""What the robot's LiDAR has met and passed through, remembered over the floor, and what it tells the camera's map.

A grid of log-odds of its own, in the frame of the camera's map. The LiDAR measures to the centimetre, in the plane of
its beams: a hit overrules the camera, a free beam speaks against it, but what is lower than the beams is the camera's
alone to see, so that free beams do not erase what the camera is sure of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.scan_kernels import Fan, Middles, Window, fused, passed
from revnm_server.observation import Image32

_BoolGrid = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ScanSpec:
    """Weights and times.

    Attributes:
        hit_logit: Log-odds that a scan's hits add to a cell.
        free_logit: Log-odds that a scan's free beams take from a cell. Less than the hit's: beams graze walls.
        most_hit_logit: Bound of what is remembered of hits.
        most_free_logit: Bound of what is remembered of free beams.
        sure_logit: From here on a hit overrules the camera, and a free cell is floor.
        hit_decay_s: Time constant with which hits fade that are not seen again.
        free_decay_s: The same of free floor.
        reach_m: Beams count up to here; pose errors move what is farther.
        margin_m: So far before its hit a beam clears nothing.
    """

    hit_logit: float = 1.2
    free_logit: float = 0.5
    most_hit_logit: float = 3.5
    most_free_logit: float = 2.5
    sure_logit: float = 1.0
    hit_decay_s: float = 180.0
    free_decay_s: float = 20.0
    reach_m: float = 6.0
    margin_m: float = 0.12


class ScanMemory:
    """The LiDAR's layer of one camera's map; several robots may write into it."""

    def __init__(self, grid: MapSpec, spec: ScanSpec | None = None) -> None:
        """Start with nothing.

        Args:
            grid: Place and size of the cells: those of the camera's map.
            spec: Weights and times.
        """
        self._grid = grid
        self._spec = spec or ScanSpec()
        middles = grid.middles_m()
        x_m, y_m = middles[0, :, 0].astype(np.float32), middles[:, 0, 1].astype(np.float32)
        self._middles = Middles(x_m, y_m, np.float32(grid.cell_m))
        self.forget()

    def forget(self) -> None:
        """Forget everything, as when the map's frame has changed."""
        self._logit = np.zeros(self._grid.shape, dtype=np.float32)
        self._seen_s = np.full(self._grid.shape, -math.inf)
        self._stamp_s = -math.inf

    def update(self, scan: Scan, floor_from_robot: Pose2, stamp_s: float, *, times: int = 1) -> None:
        """Take a scan.

        Args:
            scan: With any number of beams.
            floor_from_robot: Where it was taken, in the frame of the map.
            stamp_s: When, on the clock of the pictures; older ones than the last change no decay.
            times: For how many equal scans it stands.
        """
        self._decay(stamp_s)
        window = self._around(floor_from_robot)
        part = slice(window.top, window.bottom), slice(window.left, window.right)
        hit = self._hits(scan, floor_from_robot)[part]
        free = passed(self._fan(scan, floor_from_robot), self._middles, window) & ~hit
        logit = self._logit[part]
        logit += np.float32(times * self._spec.hit_logit) * hit - np.float32(times * self._spec.free_logit) * free
        np.clip(logit, -self._spec.most_free_logit, self._spec.most_hit_logit, out=logit)
        self._seen_s[part][hit | free] = stamp_s

    @property
    def probability(self) -> Image32:
        """(Ny, Nx) float32, that something stands in a cell by the scans alone; 0.5 where they tell nothing."""
        return np.asarray(1.0 / (1.0 + np.exp(-self._logit)), dtype=np.float32)

    @property
    def met(self) -> _BoolGrid:
        """(Ny, Nx) where beams surely ended: hits that overrule the camera."""
        return np.asarray(self._logit >= self._spec.sure_logit)

    def fuse(self, camera: FloorGrid, stamp_s: float) -> FloorGrid:
        """Return the camera's map with the scans in it.

        Args:
            camera: The map of the last picture; it is not changed.
            stamp_s: Now, on the clock of the pictures.
        """
        layers = fused(
            camera.obstacle, camera.floor, camera.age_s, self._logit, self._seen_s, self._spec.sure_logit, stamp_s
        )
        return FloorGrid(camera.origin_m, camera.cell_m, *layers)

    def _decay(self, stamp_s: float) -> None:
        elapsed = stamp_s - self._stamp_s
        if elapsed <= 0.0:
            return
        self._stamp_s = stamp_s
        if math.isfinite(elapsed):
            hits, free = (math.exp(-elapsed / each) for each in (self._spec.hit_decay_s, self._spec.free_decay_s))
            self._logit *= np.where(self._logit > 0.0, np.float32(hits), np.float32(free))

    def _hits(self, scan: Scan, pose: Pose2) -> _BoolGrid:
        points = scan.points_m()
        points = pose.apply(points[np.hypot(points[:, 0], points[:, 1]) < self._spec.reach_m])
        cells = np.rint((points - np.array(self._grid.origin_m)) / self._grid.cell_m).astype(np.intp)[:, ::-1]
        inside = ((cells >= 0) & (cells < self._grid.shape)).all(axis=1)
        hit = np.zeros(self._grid.shape, dtype=np.bool_)
        hit[cells[inside, 0], cells[inside, 1]] = True
        return hit

    def _fan(self, scan: Scan, pose: Pose2) -> Fan:
        lidar = pose @ scan.robot_from_lidar
        first_rad, step_rad = np.float32(lidar.yaw_rad + scan.angle_min_rad), np.float32(scan.angle_increment_rad)
        return Fan(np.float32(lidar.x_m), np.float32(lidar.y_m), first_rad, step_rad, self._free_m(scan))

    def _free_m(self, scan: Scan) -> NDArray[np.float32]:
        """Return how far each beam (N,) clears; a beam that is no number or too short clears nothing."""
        clears = np.minimum(scan.ranges_m - np.float32(self._spec.margin_m), np.float32(self._spec.reach_m))
        return np.where(scan.ranges_m >= scan.range_min_m, clears, np.float32(0.0))  # False for what is no number

    def _around(self, pose: Pose2) -> Window:
        """Return the rows and columns within reach of a robot."""
        place, ends = (pose.y_m, pose.x_m), list[int]()
        for value, start, size in zip(place, self._grid.origin_m[::-1], self._grid.shape, strict=True):
            first, last = ((value + side * self._spec.reach_m - start) / self._grid.cell_m for side in (-1.0, 1.0))
            ends += [min(size, max(0, math.ceil(first))), min(size, max(0, math.floor(last) + 1))]
        return Window(*ends)
