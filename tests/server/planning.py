"""A planner, a wall with two gaps, and the way from one side of it to the other."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.planning.map_planner import MapPlan, MapPlanner, PlannerSettings

HALF_S = 500_000_000
GOAL = np.array([10.0, 5.0])
START = Pose2(2.0, 5.0, 0.0)
TWO_GAPS = ((6.0, 0.0, 6.2, 2.5), (6.0, 3.5, 6.2, 6.5), (6.0, 7.5, 6.2, 10.0))
CLOSED_WALL = ((6.0, 0.0, 6.2, 10.0),)


def planner(**settings) -> MapPlanner:
    return MapPlanner(PlannerSettings(**settings))


def plan(planned_by: MapPlanner, grid: FloorGrid, pose: Pose2 = START, goal=GOAL, *, name="a", at=0) -> MapPlan:
    return planned_by.plan(grid, pose, np.asarray(goal, dtype=np.float64), goal_id=name, stamp_ns=at * HALF_S)


def y_at(result: MapPlan, x_m: float) -> float:
    """Where a way crosses a line x = const."""
    assert result.way_m is not None
    return float(result.way_m[np.argmin(np.abs(result.way_m[:, 0] - x_m)), 1])
