"""The expert: the shortest way on the true map, as Nav2 plans it.

Costs are those of Nav2's inflation layer (``nav2_costmap_2d``, ``inflation_layer.hpp``), scaled as NavFn does
(``nav2_navfn_planner``, ``navfn.hpp``: neutral cost 50, factor 0.8), and divided by the neutral cost: far from
obstacles the potential is the path length in metres. Unlike in Nav2, the decay ends at 0 instead of a step, which
would bend every path that crosses it; and cells nearer than the inscribed radius are not forbidden but very dear, so
that a robot that got too near to an obstacle is led out again the shortest way. Imports numpy, scipy and numba only:
training labels millions of states with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from revnm_client.errors import RevnmError
from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.expert.potential import along, descend, march, waypoints_of
from revnm_sim.occupancy import OccupancyGrid, occupancy
from revnm_sim.world import World

INSCRIBED_M = 0.22
_INFLATION_M = 0.70
_COST_SCALING = 3.0
_COST_PER_NAV2 = 0.8 / 50.0
_INSCRIBED_COST = 300.0  # at the edge of the inscribed zone; twice as much at the obstacle
_SEED_M = (0.15, 0.5)  # where costs vary and where they do not
_LONGEST_M = 200.0


class UnreachableError(RevnmError):
    """There is no way from the start to the goal, or one of them is in an obstacle or outside the world."""


def travel_cost(distance_m: FloatArray) -> FloatArray:
    """Return the cost per metre at a distance from obstacles: 1 where it is free, inf in an obstacle."""
    decay = np.exp(-_COST_SCALING * (distance_m - INSCRIBED_M))
    rim = math.exp(-_COST_SCALING * (_INFLATION_M - INSCRIBED_M))
    cost = 1.0 + _COST_PER_NAV2 * 252.0 * np.maximum(decay - rim, 0.0) / (1.0 - rim)
    cost = np.where(distance_m > INSCRIBED_M, cost, _INSCRIBED_COST * (2.0 - distance_m / INSCRIBED_M))
    return np.where(distance_m > 0.0, cost, np.inf)


class Expert:
    """Plans on one world; grid and costs are built once."""

    def __init__(self, world: World) -> None:
        self.grid: OccupancyGrid = occupancy(world)
        self._cost = travel_cost(self.grid.distance_m) * self.grid.resolution_m
        # Regions where the robot fits, grown over the inscribed zone to its nearest region.
        fits = self.grid.distance_m > INSCRIBED_M
        regions: NDArray[np.int32] = label(fits, structure=np.ones((3, 3)))[0]
        if fits.any():
            rows, columns = distance_transform_edt(~fits, return_distances=False, return_indices=True)
            regions = regions[rows, columns]
        self._region = np.where(self.grid.occupied, 0, regions)

    def field(self, goal_m: tuple[float, float] | FloatArray) -> CostToGo:
        """Return the cost to a goal (2,), metres, from everywhere.

        Raises:
            UnreachableError: The goal is in an obstacle or outside the world.
        """
        return self._field(goal_m, self._cost)

    def shortest(self, goal_m: tuple[float, float] | FloatArray) -> CostToGo:
        """Return the same where all floor on which the robot's inscribed circle fits costs alike: geodesic lengths.

        Raises:
            UnreachableError: The goal is in an obstacle or outside the world.
        """
        fits = self.grid.distance_m > INSCRIBED_M
        return self._field(goal_m, np.where(fits, self.grid.resolution_m, self._cost))

    def _field(self, goal_m: tuple[float, float] | FloatArray, costs: FloatArray) -> CostToGo:
        goal = np.asarray(goal_m, dtype=np.float64)
        clearance = float(self.grid.clearance_m(goal))
        if clearance <= 0.0:
            raise UnreachableError(f"goal ({goal[0]:.2f}, {goal[1]:.2f}) m is in an obstacle or outside the world")
        cells = _cells(self.grid, goal)
        region = self._region[round(cells[0]), round(cells[1])]
        cost = np.where(self._region == region, costs, np.inf)
        scale = self.grid.resolution_m
        seed_m = min(_SEED_M[1], max(_SEED_M[0], clearance - _INFLATION_M))
        seed_m = max(1.5 * scale, min(seed_m, clearance - scale))
        return CostToGo(self.grid, goal, seed_m + scale, march(cost, cells[0], cells[1], seed_m / scale))


@dataclass(frozen=True, slots=True)
class CostToGo:
    """The cost of going to one goal.

    Attributes:
        grid: The map.
        goal_m: (2,) world frame.
        near_m: So near around the goal nothing stands.
        potential: (Ny, Nx) least cost from the cell's middle to the goal; metres of free floor; inf where
            there is no way.
    """

    grid: OccupancyGrid
    goal_m: FloatArray
    near_m: float
    potential: FloatArray

    def reachable(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return from which of the points (M, 2), metres, there is a way to the goal."""
        cells = np.rint(_cells(self.grid, points_m)).astype(np.int64)
        inside = np.all((cells > 0) & (cells < np.array(self.potential.shape) - 1), axis=1)
        rows, columns = np.where(np.expand_dims(inside, 1), cells, 0).T
        return np.asarray(inside & np.isfinite(self.potential[rows, columns]))

    def path(self, start_m: tuple[float, float] | FloatArray) -> FloatArray:
        """Return the way (P, 2), metres, world frame, from the start to the goal, 0.05 m between points.

        Raises:
            UnreachableError: There is none.
        """
        fine = self._descent(start_m)
        spacing_m = self.grid.resolution_m
        count = math.ceil(_length_m(fine) / spacing_m)
        points = np.empty((count, 2))
        along(fine, len(fine), spacing_m, points)
        return np.concatenate([fine[:1], points])

    def length_m(self, start_m: tuple[float, float] | FloatArray) -> float:
        """Return the length of the way from the start to the goal.

        Raises:
            UnreachableError: There is none.
        """
        return _length_m(self._descent(start_m))

    def waypoints(self, pose: Pose2, *, count: int, spacing_m: float) -> FloatArray:
        """Return the next waypoints (H, 2) of a robot, metres, in its own frame.

        Args:
            pose: ``world_from_robot``.
            count: H.
            spacing_m: Path length between waypoints; where the goal is nearer, it is repeated.

        Raises:
            UnreachableError: There is no way to the goal.
        """
        waypoints = self.waypoints_batch(np.array([pose]), count=count, spacing_m=spacing_m)[0]
        if not np.isfinite(waypoints).all():
            raise self._unreachable(np.array([pose.x_m, pose.y_m]))
        return np.asarray(waypoints)

    def waypoints_batch(self, poses: FloatArray, *, count: int, spacing_m: float) -> FloatArray:
        """Return the waypoints (M, H, 2) of many poses (M, 3) (x, y, yaw), each in its own robot's frame.

        Waypoints of a pose that cannot reach the goal are NaN.
        """
        scale = self.grid.resolution_m
        cells = np.empty((len(poses), count, 2))
        starts, goal = _cells(self.grid, poses[:, :2]), _cells(self.grid, self.goal_m)
        waypoints_of(self.potential, starts, goal, self.near_m / scale, spacing_m / scale, cells)
        ahead = _metres(self.grid, cells) - poses[:, None, :2]  # (M, H, 2)
        c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
        return np.stack([c * ahead[..., 0] + s * ahead[..., 1], c * ahead[..., 1] - s * ahead[..., 0]], axis=-1)

    def _descent(self, start_m: tuple[float, float] | FloatArray) -> FloatArray:
        """Return the way to the goal in fine steps (P, 2), metres."""
        start = np.asarray(start_m, dtype=np.float64)
        if not self.reachable(start[None])[0]:
            raise self._unreachable(start)
        scale = self.grid.resolution_m
        longest = _LONGEST_M / scale
        path = np.empty((int(longest) * 2 + 8, 2))
        begin, goal = _cells(self.grid, start), _cells(self.grid, self.goal_m)
        count = descend(self.potential, begin, goal, self.near_m / scale, longest, path)
        return _metres(self.grid, path[:count])

    def _unreachable(self, start: FloatArray) -> UnreachableError:
        goal = self.goal_m
        return UnreachableError(f"no way from ({start[0]:.2f}, {start[1]:.2f}) m to ({goal[0]:.2f}, {goal[1]:.2f}) m")


def _cells(grid: OccupancyGrid, points_m: FloatArray) -> FloatArray:
    """Return points (..., 2) as (row, column), cells with their middles at integers."""
    return np.ascontiguousarray(((points_m - np.array(grid.origin_m)) / grid.resolution_m - 0.5)[..., ::-1])


def _metres(grid: OccupancyGrid, cells: FloatArray) -> FloatArray:
    """Return (row, column) (..., 2) as points (x, y), metres."""
    return np.ascontiguousarray((cells[..., ::-1] + 0.5) * grid.resolution_m + np.array(grid.origin_m))


def _length_m(path_m: FloatArray) -> float:
    return float(np.hypot(*np.diff(path_m, axis=0).T).sum())
