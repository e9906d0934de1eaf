"""What the planner knows of the way from a start to a goal: the measure of every trial. Imports no PyBullet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revnm_sim.expert.planner import CostToGo, Expert
from revnm_sim.scenario import segment_blocked
from revnm_sim.site import Pair
from revnm_sim.world import World


@dataclass(frozen=True, slots=True)
class Route:
    """The way of a pair.

    Attributes:
        field: The expert's cost to the goal.
        expert_m: Length of the expert's way, which keeps clear of obstacles.
        geodesic_m: Length of the shortest way that the robot's inscribed circle fits through.
        blocked: Whether something stands in the straight way.
    """

    field: CostToGo
    expert_m: float
    geodesic_m: float
    blocked: bool


def plan_route(world: World, pair: Pair) -> Route:
    """Plan the way of a pair.

    Raises:
        UnreachableError: There is none.
    """
    expert = Expert(world)
    field = expert.field(pair.goal_m)
    start = np.array([[pair.start.x_m, pair.start.y_m]])
    blocked = bool(segment_blocked(expert.grid, start, np.array(pair.goal_m))[0])
    return Route(field, field.length_m(start[0]), expert.shortest(pair.goal_m).length_m(start[0]), blocked)
