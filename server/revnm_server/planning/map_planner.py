"""Plans on what is known of the floor: a way to the goal that stays the same while the map flickers, and waypoints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.planning.floor_search import FloorSearch, Found, SearchSettings, Task, corridor, crosses, impassable
from revnm_server.planning.kept_way import Carry, KeepSettings, KeptWay, Option, judge, swerves
from revnm_server.planning.travel_cost import CostSettings, travel_cost
from revnm_server.planning.way import at_lengths

_LIKELY = 1.5  # a first way seldom costs more than so many times the straight one
_GRAPH_EXCESS = 1.1  # and on the graph hardly so many times what it costs once it is smooth
_SLACK = 1.0
_BESIDE_M = 0.3  # more than the way from the robot strays from the kept one and a cell
_BEGINS_M = 0.3  # so far along it is a way's direction at the robot


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How to plan.

    Attributes:
        waypoints: How many waypoints a plan has, H.
        spacing_m: Length of way between them.
        period_s: Ways are looked for no more often, unless the kept one is blocked, left or for another goal.
        cost: What driving costs.
        search: What is a way at all.
        keep: How firmly a way is kept.

    Raises:
        ValueError: The search asks for distances to obstacles beyond those that the cost knows.
    """

    waypoints: int = 5
    spacing_m: float = 0.4
    period_s: float = 0.5
    cost: CostSettings = field(default_factory=CostSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    keep: KeepSettings = field(default_factory=KeepSettings)

    def __post_init__(self) -> None:
        if max(self.search.impassable_m, self.search.footprint_m) > self.cost.inflation_m:
            raise ValueError("nothing is known of how far obstacles are beyond the cost's inflation_m")


@dataclass(frozen=True, slots=True)
class MapPlan:
    """Where to go.

    Attributes:
        waypoints_m: (H, 2) metres, frame of the robot; where the way ends sooner its end is repeated. None if
            standing is as good as any way.
        way_m: (P, 2) the way from the robot to its end, at most 0.05 m between points, metres, frame of the map; None
            with the waypoints.
        cost: Of the way and of turning into it, in metres of free floor that was just seen; inf without one.
        reason: Why the way does not lead to the goal, or why there is none; empty where all is well.
    """

    waypoints_m: FloatArray | None
    way_m: FloatArray | None
    cost: float
    reason: str


class MapPlanner:
    """Plans for one robot; remembers its way."""

    def __init__(self, settings: PlannerSettings) -> None:
        self._settings = settings
        self._search = FloorSearch(settings.search)
        self._kept: KeptWay | None = None

    def carry(self, onto: Carry) -> None:
        """Take the kept way, if it all can be, over into a map whose frame has changed; the next plan searches anew."""
        if self._kept is not None:
            self._kept = self._kept.carried(onto)

    def plan(
        self,
        grid: FloorGrid,
        map_from_robot: Pose2,
        goal_m: FloatArray,
        *,
        goal_id: str,
        stamp_ns: int,
        has_turn: bool = True,
    ) -> MapPlan:
        """Plan from where the robot is now.

        Args:
            grid: What is known of the floor.
            map_from_robot: Where the robot is; outside of the grid it is led to it.
            goal_m: (2,) metres, frame of the map; outside of the grid it is approached through the border.
            goal_id: A new one drops the kept way.
            stamp_ns: When all this was so, nanoseconds; any clock. If it runs backwards, the way is looked for anew.
            has_turn: Without it a way that is due to be looked for, and no more, waits.
        """
        robot_m, settings = np.array(map_from_robot[:2]), self._settings
        kept, on_way = self._kept, None
        if kept is not None:
            serves = kept.serves(goal_id, goal_m, robot_m, settings.keep)
            kept = kept.followed(robot_m, goal_m) if serves else None
        due = kept is None or not 0 <= stamp_ns - kept.searched_ns < settings.period_s * 1e9
        due = due and (has_turn or kept is None or kept.way_m is None)
        if kept is not None and not due and kept.way_m is not None:
            # What a way costs depends on the floor about it alone.
            about = grid.around(np.concatenate([robot_m[None], kept.way_m]), settings.cost.inflation_m + _BESIDE_M)
            on_way = self._option(self._task(about, map_from_robot, goal_m), kept.from_robot(robot_m), kept.short_m)
            due = on_way is not None and on_way.blocked
        if kept is None or due:
            task = self._task(grid.told(np.stack([robot_m, goal_m])), map_from_robot, goal_m)
            on_way = self._option(task, kept.from_robot(robot_m), kept.short_m) if kept else None
            kept, on_way = self._renewed(task, goal_m, kept, on_way, goal_id, stamp_ns)
        self._kept = kept
        return self._plan(kept, on_way, map_from_robot)

    def _task(self, grid: FloorGrid, map_from_robot: Pose2, goal_m: FloatArray) -> Task:
        robot_m, settings = np.array(map_from_robot[:2]), self._settings
        cost = travel_cost(grid, settings.cost)
        closed = impassable(cost, robot_m, goal_m, settings.search)
        return Task(cost, closed, map_from_robot, _LIKELY * float(np.hypot(*(goal_m - robot_m))) + _SLACK)

    def _renewed(
        self, task: Task, goal_m: FloatArray, kept: KeptWay | None, on_way: Option | None, goal_id: str, stamp_ns: int
    ) -> tuple[KeptWay, Option | None]:
        """Search, and return the way to keep from now on: the found one or the one that was kept."""
        if kept is None or on_way is None:
            found = self._search.find(task, goal_m)
            return _taken(found, goal_id, goal_m, stamp_ns), self._option(task, found.way_m, found.short_m)
        kept, on_way = self._swerved(task, kept, on_way)
        found = self._search.find(replace(task, likely=_GRAPH_EXCESS * on_way.cost + _SLACK), goal_m)
        other = self._option(task, found.way_m, found.short_m)
        leave, defeats = on_way.blocked, 0
        if other is not None:
            leave, defeats = judge(on_way, other, kept.defeats, self._settings.keep)
        if leave:
            return _taken(found, goal_id, goal_m, stamp_ns), other
        return replace(kept, defeats=defeats, searched_ns=stamp_ns), on_way

    def _swerved(self, task: Task, kept: KeptWay, on_way: Option) -> tuple[KeptWay, Option]:
        """Return the best way in the corridor of the kept one, if that is worth it; else the kept one."""
        keep = self._settings.keep
        end_m = on_way.way_m[-1]
        beside = corridor(on_way.way_m, task.cost, keep.corridor_m)
        likely = _GRAPH_EXCESS * on_way.cost + _SLACK
        found = self._search.find(replace(task, closed=task.closed | ~beside, likely=likely), end_m)
        other = self._option(task, found.way_m, kept.short_m + found.short_m)
        if other is None or not swerves(on_way, other, keep):
            return kept, on_way
        return replace(kept, way_m=other.way_m), other

    def _option(self, task: Task, way_m: FloatArray | None, short_m: float) -> Option | None:
        if way_m is None:
            return None
        begins = task.map_from_robot.inverse().apply(at_lengths(way_m, np.array([_BEGINS_M])))[0]
        turn = self._settings.keep.turn_m_per_rad * abs(math.atan2(begins[1], begins[0]))
        return Option(way_m, task.cost.of_way(way_m) + turn, short_m, crosses(way_m, task.closed, task.cost))

    def _plan(self, kept: KeptWay, on_way: Option | None, map_from_robot: Pose2) -> MapPlan:
        if on_way is None:
            return MapPlan(None, None, np.inf, kept.reason)
        lengths = self._settings.spacing_m * np.arange(1.0, self._settings.waypoints + 1.0)
        waypoints = map_from_robot.inverse().apply(at_lengths(on_way.way_m, lengths))
        return MapPlan(waypoints, on_way.way_m, on_way.cost, kept.reason)


def _taken(found: Found, goal_id: str, goal_m: FloatArray, stamp_ns: int) -> KeptWay:
    return KeptWay(goal_id, goal_m, found.way_m, found.short_m, found.reason, stamp_ns)
