"""Looks for the cheapest way over the floor from a robot to a goal, or to the reachable place nearest to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.mppi.distance_field import squared_distance
from revnm_server.planning.floor_graph import FAR, Cell, FloorGraph
from revnm_server.planning.search_kernels import open_window
from revnm_server.planning.travel_cost import TravelCost
from revnm_server.planning.way_smoothing import smooth

BoolArray = NDArray[np.bool_]

_GRAPHS = 4  # of about an ellipse, a corridor and the whole floor, for one robot
_JUST = 1e-6  # cells: a middle just so far away belongs to a corridor
_STEP = 20  # cells: the shapes that are searched are few


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """What is a way at all.

    Attributes:
        footprint_m: What is so near to the robot is under it: it cannot be an obstacle.
        impassable_m: Nearer to a sure obstacle no way goes: of gaps narrower than twice this, none is tried.
        lenient_m: That does not hold so near to the robot and to the goal, which are where they are.
        gain_m: A place that is not the goal must be so much nearer to it than the robot is.
    """

    footprint_m: float = 0.22
    impassable_m: float = 0.12
    lenient_m: float = 0.35
    gain_m: float = 0.30


@dataclass(frozen=True, slots=True)
class Task:
    """Where to look for a way.

    Attributes:
        cost: Of the cells.
        closed: (Ny, Nx) cells that no way may enter; not the robot's own.
        map_from_robot: Where the robot is; may be outside of the grid.
        likely: The way is expected to cost no more; only the time of the search depends on it.
    """

    cost: TravelCost
    closed: BoolArray
    map_from_robot: Pose2
    likely: float

    @property
    def robot_m(self) -> FloatArray:
        """(2,) where the robot is, metres, frame of the map."""
        return np.array(self.map_from_robot[:2])


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found.

    Attributes:
        way_m: (P, 2) from the robot to where it leads, evenly spaced, metres, frame of the map; None if standing is
            as good.
        short_m: How far from the goal the way ends; 0 where it leads to the goal.
        reason: Why it does not lead to the goal; empty where it does.
    """

    way_m: FloatArray | None
    short_m: float
    reason: str


def impassable(cost: TravelCost, robot_m: FloatArray, goal_m: FloatArray, settings: SearchSettings) -> BoolArray:
    """Return the cells (Ny, Nx) that no way may enter; never the robot's own."""
    closed = cost.sure_m <= settings.impassable_m
    near = np.argwhere(closed)
    middles_m = cost.grid.points_m(near.astype(np.float64))
    from_robot, from_goal = (np.hypot(*(middles_m - end_m).T) for end_m in (robot_m, goal_m))
    lenient = np.minimum(from_robot, from_goal) <= settings.lenient_m
    open_ = (lenient & (cost.sure_m[closed] > 0.0)) | (from_robot <= settings.footprint_m)
    closed[tuple(near[open_].T)] = False
    closed[_cell(cost, robot_m)] = False
    return np.asarray(closed)


class FloorSearch:
    """Searches grids; keeps the graphs of the last shapes."""

    def __init__(self, settings: SearchSettings) -> None:
        self._settings = settings
        self._graphs: dict[tuple[int, ...], FloorGraph] = {}  # least recently used first

    def find(self, task: Task, goal_m: FloatArray) -> Found:
        """Look for the way to a goal (2,), metres, frame of the map.

        A goal outside of the grid is approached through the border cell nearest to it, then straight. Where the goal,
        or that cell, cannot be reached, the way leads to the reachable cell nearest to it on which the robot fits.
        """
        cost, entry = task.cost, _cell(task.cost, goal_m)
        reachable = _connected(task.closed, _cell(cost, task.robot_m))
        if reachable[entry]:
            return Found(self._way(task, entry, goal_m), 0.0, "")
        nearest = self._nearest(cost, reachable, goal_m)
        end_m = cost.grid.points_m(np.array(nearest, dtype=np.float64))
        short_m, standing_m = float(np.hypot(*(goal_m - end_m))), float(np.hypot(*(goal_m - task.robot_m)))
        why = "an obstacle stands on the goal" if cost.sure_m[entry] == 0.0 else "obstacles shut the goal off"
        if short_m > standing_m - self._settings.gain_m:
            return Found(None, standing_m, f"{why}, and the robot is as near as it can get ({standing_m:.1f} m)")
        return Found(self._way(task, nearest, end_m), short_m, f"{why}: the way ends {short_m:.1f} m before it")

    def _nearest(self, cost: TravelCost, reachable: BoolArray, goal_m: FloatArray) -> Cell:
        """Return the reachable cell nearest to the goal; if there is one, one on which the robot fits."""
        roomy = reachable & (cost.sure_m > self._settings.footprint_m)
        choice = np.argwhere(roomy if roomy.any() else reachable)
        row, column = choice[np.argmin(np.hypot(*(choice - cost.grid.cells(goal_m)).T))]
        return int(row), int(column)

    def _way(self, task: Task, entry: Cell, end_m: FloatArray) -> FloatArray:
        cost, cells = task.cost, self._cells(task, entry)
        # The end cells' middles would be detours from where robot and goal are, unless these are outside.
        inner = cells[1:-1] if cost.grid.covers(task.robot_m) else cells[:-1]
        inner = inner if cost.grid.covers(end_m) else np.concatenate([inner, cells[-1:]])
        points = cost.grid.points_m(inner.astype(np.float64))
        return smooth(np.concatenate([task.robot_m[None], points, end_m[None]]), cost)

    def _cells(self, task: Task, entry: Cell) -> NDArray[np.int64]:
        """Return the cheapest way's cells (P, 2) (row, column).

        A metre costs at least 1, so that a way of a likely cost stays in an ellipse about its ends: that is searched
        first, and the whole floor only if the way turns out to be dearer.
        """
        start = _cell(task.cost, task.robot_m)
        likely = task.likely / task.cost.grid.cell_m
        cells = self._cheapest(task, start, entry, likely)
        if cells is None:
            cells = self._cheapest(task, start, entry, FAR)
        return np.array([start]) if cells is None else cells  # both lie off the map, where a corridor has no cells

    def _cheapest(self, task: Task, start: Cell, entry: Cell, limit: float) -> NDArray[np.int64] | None:
        """Return the cheapest way's cells (P, 2); None if it costs more than a limit. Only open cells are looked at."""
        closed = np.ascontiguousarray(task.closed)
        part, *corner = open_window(task.cost.per_m, closed, start, entry, limit, _STEP)
        graph = self._graphs.pop(part.shape, None) or FloorGraph((part.shape[0], part.shape[1]))
        self._graphs[part.shape] = graph
        if len(self._graphs) > _GRAPHS:
            del self._graphs[next(iter(self._graphs))]
        to_entry = graph.to_cell(part, (entry[0] - corner[0], entry[1] - corner[1]), limit=limit)
        begin = start[0] - corner[0], start[1] - corner[1]
        return to_entry.cells_from(begin) + corner if np.isfinite(to_entry.potential[begin]) else None


def corridor(way_m: FloatArray, cost: TravelCost, width_m: float) -> BoolArray:
    """Return the cells (Ny, Nx) that are no farther than a width from a way (P, 2) whose points are close."""
    on = np.zeros(cost.per_m.shape, dtype=np.bool_)
    rows, columns = _inner_cells(way_m, cost)
    on[rows, columns] = True
    width = width_m / cost.grid.cell_m + _JUST  # cells
    return np.asarray(squared_distance(on, math.ceil(width)) <= width * width)


def crosses(way_m: FloatArray, closed: BoolArray, cost: TravelCost) -> bool:
    """Tell whether a way (P, 2) enters a closed cell."""
    rows, columns = _inner_cells(way_m, cost)
    return bool(closed[rows, columns].any())


def _inner_cells(way_m: FloatArray, cost: TravelCost) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows (Q,) and columns (Q,) of the points (P, 2) that are on the grid."""
    cells = np.rint(cost.grid.cells(way_m)).astype(np.int64)
    inside = np.all((cells >= 0) & (cells < cost.per_m.shape), axis=1)
    return cells[inside, 0], cells[inside, 1]


def _connected(closed: BoolArray, start: Cell) -> BoolArray:
    """Return the cells (Ny, Nx) that can be reached from one; not over the corners of closed ones."""
    free = np.logical_not(closed).view(np.uint8)
    labels = cv2.connectedComponents(free, connectivity=4)[1]
    return np.asarray(labels == labels[start])


def _cell(cost: TravelCost, point_m: FloatArray) -> Cell:
    """Return the cell (row, column) of a point (2,), or of the border nearest to it."""
    row, column = np.clip(np.rint(cost.grid.cells(point_m)), 0, np.array(cost.per_m.shape) - 1)
    return int(row), int(column)
