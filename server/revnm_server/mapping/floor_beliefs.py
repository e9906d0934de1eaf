"""What a policy believes to stand on the floor, cell by cell, averaged over time. Imports numpy and OpenCV only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.map_window import onto_grid
from revnm_server.mapping.node_grid import NodeGrid
from revnm_server.observation import Image32

_AVERAGE_S = 0.8  # time constant
_FRESH_NS = 1_000_000_000
_LARGEST = np.float32(0.9)  # less than what the planner calls sure
_ALL = 0.999  # of the nodes about a cell
_NS_PER_S = 1e9


class FloorBeliefs:
    """The beliefs about one map."""

    def __init__(self, spec: MapSpec) -> None:
        """Begin with none.

        Args:
            spec: Size of the map.
        """
        self._spec = spec
        self.forget()

    def forget(self) -> None:
        """Forget everything."""
        self._occupied = np.full(self._spec.shape, np.nan, dtype=np.float32)
        self._stamp_ns = np.zeros(self._spec.shape, dtype=np.int64)

    def take(self, windows: Sequence[tuple[Image32, Pose2]], stamp_ns: int) -> None:
        """Take what a policy believes around robots.

        A policy judges the same floor otherwise whenever the robot turns or the depth flickers, so that a belief is
        averaged with those before it, and with those about other robots of now.

        Args:
            windows: (side, side), probabilities that something stands there, and the pose of the robot in its middle.
            stamp_ns: As of when.
        """
        drawn = np.stack([onto_grid(window, self._spec.unknown(), place) for window, place in windows])
        count = (~np.isnan(drawn)).sum(axis=0)
        new = count > 0
        before, now = self._occupied[new], np.nansum(drawn[:, new], axis=0) / count[new]
        elapsed_s = (stamp_ns - self._stamp_ns[new]) / _NS_PER_S
        first = np.isnan(before) | (elapsed_s < 0.0)  # or after one of a later time
        share = np.where(first, 1.0, -np.expm1(-np.abs(elapsed_s) / _AVERAGE_S)).astype(np.float32)
        self._occupied[new] = share * now + (1.0 - share) * np.nan_to_num(before)
        self._stamp_ns[new] = stamp_ns

    def carry(self, before: FloorCamera, now: FloorCamera) -> None:
        """Move beliefs into the frame of a new calibration, to where it has the pixels of their places; drop others."""
        if np.isnan(self._occupied).all():
            return
        coarse = NodeGrid(self._spec.shape)
        at_nodes, valid = now.carry(self._spec.middles_m()[coarse.nodes], before)
        places_m, known = coarse.filled(at_nodes), coarse.filled(valid.astype(np.float32)) > _ALL
        cells = np.rint((places_m - np.array(self._spec.origin_m)) / self._spec.cell_m)[..., ::-1]
        known &= ((cells >= 0.0) & (cells < self._spec.shape)).all(axis=-1)
        row, column = np.moveaxis(np.where(known[..., None], cells, 0.0).astype(np.intp), -1, 0)
        self._occupied = np.where(known, self._occupied[row, column], np.float32(np.nan))
        self._stamp_ns = self._stamp_ns[row, column]

    def into(self, grid: FloorGrid, met: NDArray[np.bool_] | None, stamp_ns: int) -> FloorGrid:
        """Return a map with the beliefs in it, as of a time.

        Where nothing is known they count however old they are. Where the camera sees, those of just now take the map's
        place: a policy has learnt how depth is wrong. What a scan has met stays. None is sure of an obstacle: a policy
        makes ways dear, but shuts none.

        Args:
            grid: The map.
            met: (Ny, Nx) where scans met something.
            stamp_ns: Now.
        """
        held = ~np.isnan(self._occupied)
        if not held.any():
            return grid
        open_to = held & ((stamp_ns - self._stamp_ns <= _FRESH_NS) | ~grid.known)
        if met is not None:
            open_to &= ~met
        obstacle = np.where(open_to, np.minimum(self._occupied, _LARGEST), grid.obstacle)
        return replace(grid, obstacle=obstacle.astype(np.float32))
