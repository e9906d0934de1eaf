"""Random goals that the robot can reach, by the expert's judgement on the true map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_sim.expert.planner import INSCRIBED_M, CostToGo, Expert
from revnm_sim.rays.raycast import visible
from revnm_sim.scenario import Scenario, at_height, free_places, tag_seen
from revnm_sim.world import primitive_arrays

_PLACES = 200
_DRAWS = 50
_LEAST_M = 1.5
_LEAVING_M = 0.3  # of the way: the robot may begin nearer to an obstacle than it may pass
_START_S = 30.0
_PATIENCE = 4.0


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go.

    Attributes:
        place_m: (x, y) on the floor, world frame.
        pixel: (u, v) of that in the camera's picture.
        way_m: Length of the expert's way there.
        limit_s: Time that the robot has: half a minute, and four times what the expert's way takes at full speed. What
            faults take, until the robot drives again, is added to it.
    """

    place_m: tuple[float, float]
    pixel: tuple[float, float]
    way_m: float
    limit_s: float


class GoalDraw:
    """Draws goals in one scenario.

    Args:
        scenario: World, camera and robot.
        rng: Decides the draws.
    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._camera, self._robot, self._rng = scenario.camera, scenario.robot, rng
        self._arrays = primitive_arrays(scenario.world.obstacles)
        self._expert = Expert(scenario.world)

    def draw(self, robot_m: tuple[float, float]) -> Goal:
        """Return a goal that a robot at ``robot_m``, metres, can reach.

        It is 1.5 m away at least; the robot may stand there in any heading; the camera sees the floor there and would
        see the whole tag; and the expert's way is as wide as the robot all along, but for its first 0.3 m.

        Raises:
            ContractError: There is none.
        """
        start = np.array(robot_m)
        for _ in range(_DRAWS):
            for place in self._places(start):
                to_goal = self._expert.field(place)
                if to_goal.reachable(start[None])[0] and _is_wide(to_goal, way := to_goal.path(start)):
                    return self._goal(place, float(np.hypot(*np.diff(way, axis=0).T).sum()))
        raise ContractError(f"no goal can be reached from ({start[0]:.2f}, {start[1]:.2f}) m")

    def _places(self, start: FloatArray) -> FloatArray:
        """Draw places (M, 2) far from the start that the camera sees, with a robot there and without."""
        places = free_places(self._expert.grid, self._rng, count=_PLACES)
        places = places[np.hypot(*(places - start).T) >= _LEAST_M]
        places = places[visible(self._arrays, self._camera, at_height(places, 0.0))]
        return np.asarray(places[tag_seen(self._arrays, self._camera, places, self._robot)])

    def _goal(self, place: FloatArray, way_m: float) -> Goal:
        pixel, _ = self._camera.project(np.append(place, 0.0))
        limit_s = _START_S + _PATIENCE * way_m / self._robot.max_v_mps
        return Goal((float(place[0]), float(place[1])), (float(pixel[0]), float(pixel[1])), way_m, limit_s)


def _is_wide(to_goal: CostToGo, way_m: FloatArray) -> bool:
    beyond = way_m[np.hypot(*(way_m - way_m[0]).T) > _LEAVING_M]
    return bool(to_goal.grid.clearance_m(beyond).min() > INSCRIBED_M)
